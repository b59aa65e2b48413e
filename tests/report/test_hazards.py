"""What stands out of a cloud of points, against scenes that were built to order and against closed forms."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from lidar_emu.cli import cli
from lidar_emu.errors import InputError
from lidar_emu.report.hazards import (
    BOULDERS_M,
    CIRCLES_M,
    LEAST_POINTS,
    SIGMAS,
    Cloud,
    bands_of,
    cloud_of,
    draw_hazards,
    touched_shares,
)
from lidar_emu.scenario.load import load, require_flight
from lidar_emu.shots.flight_model import FlightModel

pytestmark = pytest.mark.slow

FLAT = {"site": "flat", "instrument": "ndl_as_published"}
RANGE_BIN_M = 0.343085
TRACK = np.sqrt(0.5)


def cloud(**overrides: str) -> Cloud:
    return cloud_of(FlightModel(require_flight(load("hazards", {**FLAT, **overrides}))))


def test_level_ground_has_nothing_that_stands_out() -> None:
    seen = cloud()
    np.testing.assert_allclose(seen.true_off_m, 0.0, atol=1e-9)
    assert not seen.stands_out.any()
    # Two bins, along a beam at 22.5 degrees; a plane through at least LEAST_POINTS others adds a little.
    own_m = RANGE_BIN_M / np.sqrt(6) * np.cos(np.radians(22.5))
    assert (seen.sigma_m > own_m * (1 - 1e-5)).all()
    assert np.median(seen.sigma_m) < own_m * np.sqrt(1 + 1 / LEAST_POINTS)
    bands = bands_of(seen)
    assert sum(band.points for band in bands) == len(seen.off_m)
    assert all(band.detected is None and band.alarms == 0.0 for band in bands if band.level > 0)


@pytest.mark.parametrize(("height_m", "reported"), [(1.2, True), (0.2, False)])
def test_slab_in_a_track_stands_out_if_it_is_high_enough(height_m: float, reported: bool) -> None:
    # Two metres of the track of the first beam, which runs to the north-east, 60 m out: 145 m up.
    place = 60 * TRACK
    slab = f"{{kind: slab, name: block, east_m: {place}, north_m: {place}, yaw_deg: 45, length_m: 2, width_m: 2, "
    seen = cloud(**{"site.objects": f"[{slab}height_m: {height_m}}}]"})
    on_top = seen.true_off_m > height_m / 2
    assert on_top.sum() >= 3
    np.testing.assert_allclose(seen.true_off_m[on_top], height_m, atol=0.35 * height_m)
    assert seen.stands_out[on_top].all() == reported
    assert not seen.stands_out[np.abs(seen.true_off_m) < 0.05].any()


def test_errors_of_a_point_and_its_plane_are_as_large_as_foretold() -> None:
    seen = cloud(**{"timing.rate_hz": "97"})
    error = (seen.off_m - seen.true_off_m) / seen.sigma_m
    assert np.abs(error).max() < SIGMAS
    assert error.std() == pytest.approx(1.0, rel=0.1)


def test_slopes_are_those_of_the_plane() -> None:
    """Of four beams at the horizontal distance r the slope has the standard deviation σ_z / (r √2) on each axis."""
    seen = cloud(**{"site.ground": "{kind: plane, slope_deg: 5, downhill_azimuth_deg: 90}"})
    np.testing.assert_allclose(seen.true_slope_deg, 5.0, atol=1e-6)
    flat = cloud()
    radius_m = flat.slope_altitude_m * np.tan(np.radians(22.5))
    sigma_z_m = RANGE_BIN_M / np.sqrt(6) * np.cos(np.radians(22.5))
    np.testing.assert_allclose(flat.slope_base_m, 2 * radius_m, rtol=1e-9)
    np.testing.assert_allclose(
        flat.slope_sigma_deg, np.degrees(np.arctan(sigma_z_m / (radius_m * np.sqrt(2)))), rtol=0.01
    )
    high = seen.slope_altitude_m > 100
    assert np.abs(seen.slope_deg - 5.0)[high].max() < 5 * seen.slope_sigma_deg[high].max()


def test_boulders_touched_by_a_line_of_points() -> None:
    """A line through a circle's middle touches the band of a boulder's width about it."""
    line_m = np.stack([np.linspace(-150, 150, 30_001), np.zeros(30_001)], axis=-1)
    nothing = np.empty(0)
    shares = touched_shares(Cloud(*[nothing] * len(Cloud._fields))._replace(seen_m=line_m))
    for i, circle_m in enumerate(CIRCLES_M):
        half = np.array(BOULDERS_M) / 2 / circle_m
        band = 2 / np.pi * (np.arcsin(half) + half * np.sqrt(1 - half**2))
        np.testing.assert_allclose(shares[i], band, rtol=0.05, atol=0.002)


def test_flight_without_surroundings_is_refused() -> None:
    with pytest.raises(InputError, match="without neighbouring points"):
        cloud(**{"timing.rate_hz": "0.1"})


def test_command_prints_what_the_library_finds() -> None:
    done = CliRunner().invoke(cli, ["hazards", "hazards", "--json", "--set", "site=flat"])
    printed = json.loads(done.stdout)
    assert [band["points"] for band in printed["bands"]] == [
        band.points for band in bands_of(cloud(instrument="ndl_four_beam"))
    ]
    assert len(printed["touched"]["shares"]) == len(printed["touched"]["circles_m"])


def test_the_plot_shows_every_point_and_share() -> None:
    seen = cloud()
    bands, shares = bands_of(seen), touched_shares(seen)
    heights, detection, slopes, boulders = draw_hazards(seen, bands, shares, "a title").axes
    dim, red, threshold = (line.get_xydata() for line in heights.lines)
    assert len(dim) + len(red) == len(seen.off_m)
    assert len(red) == seen.stands_out.sum()
    assert threshold[:, 1].tolist() == [band.detected_from_m for band in bands]
    assert len(detection.lines[1].get_xdata()) == sum(band.alarms is not None for band in bands)
    assert len(slopes.lines[0].get_xdata()) == len(seen.slope_deg)
    drawn = np.array([line.get_ydata() for line in boulders.lines]).T
    np.testing.assert_allclose(drawn, 100 * shares)


def test_command_plots(tmp_path) -> None:
    picture = tmp_path / "hazards.png"
    done = CliRunner().invoke(cli, ["hazards", "hazards", "--plot", str(picture), "--set", "site=flat"])
    assert done.exit_code == 0
    assert picture.read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(InputError, match=r"use \.png"):
        CliRunner().invoke(
            cli, ["hazards", "hazards", "--plot", str(tmp_path / "hazards.jpg")], catch_exceptions=False
        )
