"""Axes of the report's figures: outliers neither flatten them nor vanish."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lidar_emu.numerics.vector_arrays import SITE_FROM_NED
from lidar_emu.report.beam_colours import beam_colour
from lidar_emu.report.flight_figures import draw_errors, draw_path, draw_truth, roll_pitch_heading_deg
from lidar_emu.report.ground_survey import extent_of, slope_to_sun
from lidar_emu.report.plot_style import error_limits, truth_limits

OUTLIERS = 9


@pytest.fixture
def faulty(flight):
    """The flight with a few ranges wrong by kilometres, up and down."""
    range_m = flight.range_m.copy()
    places = np.argwhere(flight.range_valid)[:: flight.range_valid.sum() // OUTLIERS][:OUTLIERS]
    for number, (shot, beam) in enumerate(places):
        range_m[shot, beam] += 7000.0 if number % 3 else -5000.0
    return replace(flight, range_m=range_m)


def triangles(axes) -> int:
    return sum(len(line.get_xdata()) for line in axes.lines if line.get_marker() in ("^", "v"))


def outside(axes, values) -> int:
    low, high = axes.get_ylim()
    return int(np.count_nonzero((values < low) | (values > high)))


@pytest.mark.parametrize("draw", [np.random.default_rng(1).normal, np.random.default_rng(2).uniform])
def test_limits_contain_all_errors_without_outliers(draw) -> None:
    errors = draw(size=5000)
    limits = error_limits(errors, 0.01)
    assert limits.contain(errors).mean() >= 0.99
    assert limits.high - limits.low < 1.1 * np.ptp(np.append(errors, 0.0))


def test_outliers_do_not_widen_limits() -> None:
    rng = np.random.default_rng(3)
    errors = rng.normal(size=5000)
    wrong = rng.random(5000) < 0.05
    limits = error_limits(np.where(wrong, rng.uniform(-1e4, 1e4, 5000), errors), 0.01)
    assert limits.contain(errors[~wrong]).mean() >= 0.99
    assert limits.high - limits.low < 20.0


def test_limits_without_spread_or_values() -> None:
    assert error_limits(np.zeros(10), 0.01).contain(np.array([-0.01, 0.01])).all()
    assert error_limits(np.full(3, np.nan), 0.5) == (-0.5, 0.5)
    assert truth_limits(np.array([1.0, 9.0]), np.full(2, np.nan)).contain(np.array([1.0, 9.0])).all()


def test_each_value_outside_the_axes_has_a_triangle(faulty) -> None:
    error_m = (faulty.range_m - faulty.true_range_m)[faulty.range_valid]
    along = draw_errors(faulty).figure.axes[0]
    assert triangles(along) == outside(along, error_m) == OUTLIERS
    assert "9 outside the axes" in draw_errors(faulty).description
    above = draw_truth(faulty).figure.axes[0]
    assert triangles(above) == outside(above, faulty.range_m[faulty.range_valid]) == OUTLIERS


def test_a_flight_without_outliers_has_no_triangles(flight) -> None:
    for drawing in (draw_errors(flight), draw_truth(flight)):
        assert sum(map(triangles, drawing.figure.axes)) == 0
        assert "outside" not in drawing.description


def test_histograms_label_what_lies_beyond(faulty) -> None:
    valid = faulty.range_valid
    ratio = ((faulty.range_m - faulty.true_range_m) / faulty.sigma_range_m)[valid]
    spread = draw_errors(faulty).figure.axes[1]
    labels = [text.get_text() for text in spread.texts]
    assert f"{100 * (ratio < -5).mean():.2g} %\nbelow -5" in labels
    assert f"{100 * (ratio > 5).mean():.2g} %\nabove 5" in labels
    shown = sum(bar.get_height() * bar.get_width() for bar in spread.patches)
    assert shown == pytest.approx((np.abs(ratio) <= 5).mean())


def test_the_map_fits_path_and_true_hit_points(faulty, flight) -> None:
    axis_m = (flight.point_site_m - flight.position_site_m[:, None]) / flight.range_m[..., None]
    truth_m = flight.position_site_m[:, None] + axis_m * flight.true_range_m[..., None]
    point_m = flight.position_site_m[:, None] + axis_m * faulty.range_m[..., None]
    wrong = replace(faulty, true_point_site_m=truth_m, point_site_m=point_m)
    extent = extent_of(wrong)
    seen_m = np.concatenate([truth_m.reshape(-1, 3), flight.position_site_m])
    seen_m = seen_m[np.isfinite(seen_m).all(axis=1)]
    assert (seen_m >= extent.low_m).all()
    assert (seen_m <= extent.high_m).all()
    assert (extent.high_m - extent.low_m < 1.3 * np.ptp(seen_m, axis=0)).all()
    above = draw_path(wrong, None).figure.axes[0]
    crosses = [line for line in above.lines if line.get_marker() == "x"]
    far = np.any((point_m < extent.low_m) | (point_m > extent.high_m), axis=2) & wrong.range_valid
    assert sum(len(line.get_xdata()) for line in crosses) == far.sum() > 0


def test_the_map_has_the_points_of_each_beam_in_its_colour(flight) -> None:
    above = draw_path(flight, None).figure.axes[0]
    shown = {line.get_color(): len(line.get_xdata()) for line in above.lines if line.get_marker() == "."}
    assert shown == {
        beam_colour(beam): flight.range_valid[:, beam].sum() for beam in range(flight.beam_count)
    }


def test_the_edge_of_elevation_data_is_no_slope() -> None:
    """Rough ground, 5 m above the level ground beyond it."""
    east_m, north_m = np.meshgrid(np.arange(40.0), np.arange(40.0))
    over = (np.abs(east_m - 20) < 10) & (np.abs(north_m - 20) < 10)
    up_m = np.where(over, 5.0 + np.random.default_rng(4).normal(scale=0.1, size=over.shape), 0.0)
    light, _ = slope_to_sun(np.stack([east_m, north_m, up_m], axis=-1))
    inside = over[:-1, :-1] & over[:-1, 1:] & over[1:, 1:] & over[1:, :-1]
    assert (light[~inside] == 0.0).all()
    assert np.abs(light[inside]).mean() > 0.2


def test_attitude_angles_turn_north_east_down_into_the_body() -> None:
    given_deg = np.array([[10.0, 20.0, 30.0], [-170.0, -80.0, 100.0], [0.0, 0.0, 170.0], [5.0, 1.0, 190.0]])
    ned_from_body = Rotation.from_euler("ZYX", given_deg[:, ::-1], degrees=True)
    x, y, z, w = (Rotation.from_matrix(SITE_FROM_NED) * ned_from_body).as_quat().T
    found_deg = roll_pitch_heading_deg(np.stack([w, x, y, z], axis=-1))
    np.testing.assert_allclose(found_deg, given_deg, atol=1e-9)
