"""Descents over real maps of the Moon and along a real flight, beside geometry worked out here.

The ground is read with rasterio and cut by bisection; nothing of the project's casting or pointing is used.
"""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray
from twins import APOLLO, ARISTARCHUS, HERODOTUS, MOLA

import lidar_emu
from lidar_emu.cli import cli
from lidar_emu.errors import InputError
from lidar_emu.measurement import Measurement
from lidar_emu.scenario.site import ElevationGrid, Origin
from lidar_emu.scene.terrain.read import read_terrain

rasterio = pytest.importorskip("rasterio")

VALIDITY_S = round(2 * 300e-6 - 131_072 / 600e6 / 2, 9)
"""Centre of the constant segment's record, by the waveform of ndl_four_beam, in whole nanoseconds."""

Floats = NDArray[np.float64]


def flown(folder: Path, ground: dict[str, Any], trajectory: str, pattern: str, rate_hz: float) -> Measurement:
    """A scenario file with these parts, simulated."""
    lines = [f"    {key}: {value}" for key, value in ground.items()]
    text = "\n".join([
        "name: real",
        f"timing: {{rate_hz: {rate_hz}}}",
        "instrument: ndl_as_published",
        "site:", "  name: real", "  ground:", *lines,
        f"scanner: {{pattern: {pattern}}}",
        f"trajectory: {trajectory}",
    ])  # fmt: skip
    (folder / "real.yaml").write_text(text + "\n")
    return lidar_emu.simulate(lidar_emu.load(folder / "real.yaml"), seed=1)


def map_of(file: Path, **keys: Any) -> dict[str, Any]:
    return {"kind": "grid", "file": file, "band": "qts_demstack", "placement": "flat", **keys}


@dataclass
class Surface:
    """The bilinear surface through the samples of a band, above the middle of the map."""

    elevation_m: Floats
    pixel_m: float

    @classmethod
    def read(cls, file: Path, band: int) -> Surface:
        with rasterio.open(file) as stream:
            surface = cls(stream.read(band).astype(np.float64), stream.transform.a)
        surface.elevation_m -= surface.height_m(np.zeros(1), np.zeros(1))
        return surface

    def height_m(self, east_m: Floats, north_m: Floats) -> Floats:
        """NaN beyond the outermost samples."""
        rows, columns = self.elevation_m.shape
        across = (columns - 1) / 2 + east_m / self.pixel_m
        down = (rows - 1) / 2 - north_m / self.pixel_m
        outside = (across < 0) | (across > columns - 1) | (down < 0) | (down > rows - 1)
        column = np.clip(np.floor(across), 0, columns - 2).astype(int)
        row = np.clip(np.floor(down), 0, rows - 2).astype(int)
        a, b, z = across - column, down - row, self.elevation_m
        upper = z[row, column] * (1 - a) + z[row, column + 1] * a
        lower = z[row + 1, column] * (1 - a) + z[row + 1, column + 1] * a
        return np.where(outside, np.nan, upper * (1 - b) + lower * b)

    def first_contact_m(self, origin_m: Floats, direction: Floats, step_m: float) -> Floats:
        """Range of each ray (n, 3): steps to the first change of sign, then bisection. Rays stay over the map."""

        def above_m(range_m: Floats) -> Floats:
            point_m = origin_m + range_m[:, None] * direction
            above: Floats = point_m[:, 2] - self.height_m(point_m[:, 0], point_m[:, 1])
            return above

        # No ground lies higher than the highest sample: march from there.
        near_m: Floats = np.maximum(0, (self.elevation_m.max() - origin_m[:, 2]) / direction[:, 2])
        assert (above_m(near_m) >= 0).all()
        marching = np.ones(len(near_m), dtype=bool)
        while marching.any():
            marching &= above_m(near_m + step_m) > 0
            near_m[marching] += step_m
        far_m = near_m + step_m
        for _ in range(60):
            middle_m = (near_m + far_m) / 2
            is_above = above_m(middle_m) > 0
            near_m, far_m = np.where(is_above, middle_m, near_m), np.where(is_above, far_m, middle_m)
        return near_m


def straight_down_m(time_s: Floats, from_m: float, from_mps: float, to_m: float, to_mps: float) -> Floats:
    """Altitude at constant deceleration: v² - v0² = 2 a s."""
    deceleration_mps2 = (from_mps**2 - to_mps**2) / (2 * (from_m - to_m))
    return from_m - from_mps * time_s + 0.5 * deceleration_mps2 * time_s**2


def square(angle_deg: float, pitch_deg: Floats | float = 0.0) -> Floats:
    """Beams (4, 3) or (4, n, 3) in east, north, up of a body that heads north and pitches up: azimuths count
    from forward over right."""
    angle, pitch = np.radians(angle_deg), np.radians(pitch_deg)
    beams = []
    for azimuth in np.radians([45, 135, 225, 315]):
        forward, right, below = (
            np.sin(angle) * np.cos(azimuth),
            np.sin(angle) * np.sin(azimuth),
            np.cos(angle),
        )
        north = forward * np.cos(pitch) + below * np.sin(pitch)
        down = below * np.cos(pitch) - forward * np.sin(pitch)
        beams.append(np.stack(np.broadcast_arrays(right, north, -down), axis=-1))
    return np.stack(beams)


def ranges_by_bisection_m(surface: Surface, altitude_m: Floats, angle_deg: float, step_m: float) -> Floats:
    origin_m = np.stack([0 * altitude_m, 0 * altitude_m, altitude_m], axis=-1)
    columns = [
        surface.first_contact_m(origin_m, np.tile(direction, (len(altitude_m), 1)), step_m)
        for direction in square(angle_deg)
    ]
    return np.stack(columns, axis=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "band", "from_m", "to_m", "angle_deg"),
    [(ARISTARCHUS, 1, 1500.0, 60.0, 22.5), (HERODOTUS, 2, 6000.0, 1500.0, 22.5)],
)
def test_true_ranges_over_a_map_are_those_of_bisection(
    public_data: Path, tmp_path: Path, name: str, band: int, from_m: float, to_m: float, angle_deg: float
) -> None:
    file = public_data / name
    with rasterio.open(file) as stream:
        assert stream.descriptions[band - 1] == "qts_demstack"
    waypoints = f"[{{altitude_m: {from_m}, speed_mps: 90}}, {{altitude_m: {to_m}, speed_mps: 5}}]"
    trajectory = f"{{kind: profile, waypoints: {waypoints}}}"
    run = flown(tmp_path, map_of(file), trajectory, f"{{kind: square, angle_deg: {angle_deg}}}", 10)
    time_s = run.shot / 10 + VALIDITY_S
    altitude_m = straight_down_m(time_s, from_m, 90, to_m, 5)
    np.testing.assert_allclose(run.position_site_m[:, 2], altitude_m, rtol=0, atol=1e-8)
    surface = Surface.read(file, band)
    expected_m = ranges_by_bisection_m(surface, altitude_m, angle_deg, step_m=surface.pixel_m / 40)
    np.testing.assert_allclose(run.true_range_m, expected_m, rtol=0, atol=1e-6)
    # The ground is rough enough to tell bands and directions apart.
    assert np.ptp(expected_m - altitude_m[:, None] / np.cos(np.radians(angle_deg)), axis=1).max() > 10
    error_m = (run.range_m - run.true_range_m)[run.range_valid]
    assert run.range_valid.mean() > 0.95
    assert np.sqrt(np.mean(error_m**2)) < 0.01 * np.median(expected_m)


def test_a_band_is_not_guessed(public_data: Path, tmp_path: Path) -> None:
    trajectory = (
        "{kind: profile, waypoints: [{altitude_m: 900, speed_mps: 9}, {altitude_m: 800, speed_mps: 9}]}"
    )
    with pytest.raises(InputError, match="qts_demstack_slope"):
        flown(
            tmp_path,
            map_of(public_data / HERODOTUS, band="elevation"),
            trajectory,
            "{kind: square, angle_deg: 9}",
            1,
        )


@pytest.mark.parametrize(
    ("latitude_deg", "longitude_deg", "lowest_m", "highest_m"),
    [
        # Badwater in Hellas, 32.79 S 62.14 E, 8.2 km deep; the rim of Olympus Mons' calderas, 17.3 N 226.9 E, 21.2 km
        # high; the poles' caps: their height in the files of radii, less the radius.
        (-32.79, 62.14, -8200, -7900),
        (17.3, 226.9, 20500, 21250),
        (17.3, -133.1, 20500, 21250),
        (90.0, 0.0, -3000, -1500),
        (-90.0, 0.0, 2500, 4500),
    ],
)
def test_known_places_of_mars(
    public_data: Path, latitude_deg: float, longitude_deg: float, lowest_m: float, highest_m: float
) -> None:
    origin = Origin(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
    terrain = read_terrain(ElevationGrid(kind="grid", file=str(public_data / MOLA), origin=origin))
    assert lowest_m < terrain.origin_elevation_m < highest_m
    assert not np.isnan(terrain.elevation_m).any()


def test_a_descent_over_curved_mars(public_data: Path, tmp_path: Path) -> None:
    """Beams of 60 degrees meet Isidis' flat floor beyond the tangent plane: by the law of cosines."""
    ground = {
        "kind": "grid",
        "file": public_data / MOLA,
        "origin": "{latitude_deg: 12.9, longitude_deg: 87.0}",
        "half_size_m": 150_000,
    }
    trajectory = (
        "{kind: profile, waypoints: [{altitude_m: 40000, speed_mps: 90}, {altitude_m: 39900, speed_mps: 90}]}"
    )
    lines = [f"    {key}: {value}" for key, value in ground.items()]
    text = "\n".join([
        "name: mars",
        "timing: {rate_hz: 5}",
        "instrument: ndl_as_published",
        "site:", "  body: {name: Mars, radius_m: 3396000}", "  ground:", *lines,
        "scanner: {pattern: {kind: square, angle_deg: 60}}",
        f"trajectory: {trajectory}",
    ])  # fmt: skip
    (tmp_path / "mars.yaml").write_text(text + "\n")
    run = lidar_emu.simulate(lidar_emu.load(tmp_path / "mars.yaml"), seed=1)
    radius_m = 3396000.0
    above_m = run.position_site_m[:, 2]
    # R² = (R + h)² + r² - 2 (R + h) r cos 60°
    on_sphere_m = (radius_m + above_m) / 2 - np.sqrt(
        (radius_m + above_m) ** 2 / 4 - above_m * (above_m + 2 * radius_m)
    )
    on_plane_m = above_m * 2
    assert (on_sphere_m - on_plane_m).min() > 1400
    # The floor is level within a few hundred metres over 150 km.
    assert np.abs(run.true_range_m - on_sphere_m[:, None]).max() < 800


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ground", "body"),
    [
        (
            f"{{kind: grid, file: FOLDER/{ARISTARCHUS}, band: qts_demstack, rock_abundance_band: dlre_ra}}",
            "{name: Moon}",
        ),
        (f"{{kind: grid, file: FOLDER/{HERODOTUS}, band: qts_demstack, beyond: sphere}}", "{name: Moon}"),
        (
            f"{{kind: grid, file: FOLDER/{MOLA}, origin: {{latitude_deg: 18.4, longitude_deg: 77.5}}}}",
            "{name: Mars, radius_m: 3396000}",
        ),
    ],
)
def test_each_map_is_planned_and_flown(public_data: Path, tmp_path: Path, ground: str, body: str) -> None:
    ground = ground.replace("FOLDER", str(public_data))
    waypoints = "[{altitude_m: 1000, speed_mps: 60}, {altitude_m: 900, speed_mps: 50}]"
    (tmp_path / "map.yaml").write_text(
        f"name: map\ntiming: {{rate_hz: 20}}\nsite: {{ground: {ground}, body: {body}}}\n"
        "instrument: ndl_four_beam\nscanner: {pattern: {kind: square, angle_deg: 10}}\n"
        f"trajectory: {{kind: profile, waypoints: {waypoints}}}\n"
    )
    planned = lidar_emu_says("plan", str(tmp_path / "map.yaml"), "--json")
    rows = {row["stage"]: row for row in json.loads(planned)["decisions"]}
    assert "placed on the body, resampled within" in rows["ground"]["how"]
    assert rows["curvature of the grid"]["computed"]
    flown = lidar_emu_says("run", str(tmp_path / "map.yaml"), "--pace", "max")
    assert "37 due of 37 planned: 37 sent" in flown


def lidar_emu_says(*arguments: str) -> str:
    """What the command prints."""
    done = CliRunner().invoke(cli, arguments)
    assert done.exit_code == 0, done.output
    return done.stdout


def apollo_descent(file: Path) -> str:
    return (
        f"{{kind: table, file: {file}, time: {{column: t_touchdown_s, unit: s}}, "
        "up: {column: alt_m, unit: m, rate_column: hdot_mps, rate_unit: m/s}, "
        "pitch: {column: pitch_from_vertical_deg, unit: deg}, "
        "from_time: -245, to_time: -11, maximum_gap_s: 40}"
    )


def apollo_rows(file: Path, *columns: str) -> Floats:
    """Columns of the rows in which all are filled, and the time before contact."""
    with file.open() as stream:
        rows = [[row[name] for name in ("t_touchdown_s", *columns)] for row in csv.DictReader(stream)]
    return np.array([row for row in rows if all(row)], dtype=np.float64).T


def between_rows(
    time_s: Floats, row_s: Floats, altitude_m: Floats, rate_mps: Floats
) -> tuple[Floats, Floats]:
    """Altitude and rate of the cubic with the given values and rates at the rows around, in Bernstein's form."""
    k = np.clip(np.searchsorted(row_s, time_s, side="right") - 1, 0, len(row_s) - 2)
    step_s = row_s[k + 1] - row_s[k]
    u = (time_s - row_s[k]) / step_s
    p0, p3 = altitude_m[k], altitude_m[k + 1]
    p1, p2 = p0 + rate_mps[k] * step_s / 3, p3 - rate_mps[k + 1] * step_s / 3
    height_m = p0 * (1 - u) ** 3 + 3 * p1 * u * (1 - u) ** 2 + 3 * p2 * u**2 * (1 - u) + p3 * u**3
    rate = 3 * ((p1 - p0) * (1 - u) ** 2 + 2 * (p2 - p1) * u * (1 - u) + (p3 - p2) * u**2) / step_s
    return height_m, rate


def test_apollo_over_a_plane(public_data: Path, tmp_path: Path) -> None:
    file = public_data / APOLLO
    run = flown(tmp_path, {"kind": "plane"}, apollo_descent(file), "{kind: square, angle_deg: 7.5}", 20)
    assert len(run) == 20 * 234
    time_s = -245 + run.shot / 20 + VALIDITY_S
    altitude_m, rate_mps = between_rows(time_s, *apollo_rows(file, "alt_m", "hdot_mps"))
    np.testing.assert_allclose(run.position_site_m[:, 2], altitude_m, rtol=0, atol=1e-8)
    np.testing.assert_allclose(run.velocity_site_mps[:, 2], rate_mps, rtol=0, atol=1e-9)
    # Shots next to a row have its displayed pitch, whatever is flown between rows.
    row_s, pitch_deg = apollo_rows(file, "pitch_from_vertical_deg")
    inside = (row_s >= -245) & (row_s < -11)
    shot = np.rint((row_s[inside] + 245) * 20).astype(int)
    beams = square(7.5, pitch_deg[inside])
    expected_m = (altitude_m[shot] / -beams[..., 2]).T
    # Half a millisecond after the row, at up to 2.5 degrees a second of pitch.
    share = np.tan(np.radians(52 + 7.5)) * np.radians(2.5) * VALIDITY_S
    np.testing.assert_allclose(run.true_range_m[shot], expected_m, rtol=share)
    np.testing.assert_allclose(
        run.true_closing_speed_mps[shot], (rate_mps[shot] * beams[..., 2]).T, rtol=share
    )
    assert run.range_valid.mean() > 0.9
