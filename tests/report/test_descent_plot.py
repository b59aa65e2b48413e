"""The picture of a descent: its contents against the measurement, and the ground by its pixels."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.image import imread

from lidar_emu import files
from lidar_emu.errors import InputError
from lidar_emu.measurement import COLUMNS
from lidar_emu.report.descent_plot import draw_descent, plot_descent
from lidar_emu.report.plot_style import check_plot_path
from lidar_emu.scene.analytic_grounds import PlaneGround

pytestmark = pytest.mark.slow

VIEW = np.s_[60:820, 0:640]
"""The view of the ground."""


@pytest.fixture
def plane():
    return PlaneGround(0.0, 0.0, 0.0)


def drawn(measurement, scene, path):
    plot_descent(measurement, scene, "a title", path)
    image = imread(path)
    assert image.shape[:2] == (950, 1600)
    return image[..., :3]


def pixels_of(image, colour):
    """How many pixels have just this colour."""
    return int((np.abs(image - np.array(colour)[:3]).max(axis=-1) < 0.02).sum())


def error_panels(figure):
    """The panels of errors, (beams, 2)."""
    return np.array([axes for axes in figure.axes if axes.name != "3d" and len(axes.lines)]).reshape(-1, 2)


def drawn_values(axes, marker):
    """Points drawn with a marker, without its size."""
    return np.concatenate([np.c_[line.get_data()] for line in axes.lines if line.get_marker() == marker])


def test_every_measurement_is_drawn_once(flight):
    """Each beam has panels of its own, in which every valid error and every dropout has a mark."""
    panels = error_panels(draw_descent(flight, None, "a title"))
    assert panels.shape == (flight.beam_count, 2)
    sizes = set()
    for column, (valid, error) in enumerate((
        (flight.range_valid, flight.range_m - flight.true_range_m),
        (flight.speed_valid, 1e3 * (flight.closing_speed_mps - flight.true_closing_speed_mps)),
    )):  # fmt: skip
        for beam, axes in enumerate(panels[:, column]):
            shown = drawn_values(axes, ".")
            np.testing.assert_array_equal(shown[:, 1], error[valid[:, beam], beam])
            lost = drawn_values(axes, "|")[:, 0]
            np.testing.assert_array_equal(lost, flight.time_s[flight.fired[:, beam] & ~valid[:, beam], beam])
            sizes |= {line.get_markersize() for line in axes.lines if line.get_marker() == "."}
    assert len(sizes) == 1


def test_errors_far_outside_are_triangles(flight):
    range_m = flight.range_m.copy()
    far = np.argwhere(flight.range_valid)[::20]
    range_m[tuple(far.T)] += 5000.0
    panels = error_panels(draw_descent(replace(flight, range_m=range_m), None, "a title"))
    counts = [
        sum(len(line.get_xdata()) for line in axes.lines if line.get_marker() == "^") for axes in panels[:, 0]
    ]
    assert counts == np.bincount(far[:, 1], minlength=flight.beam_count).tolist()
    low, high = panels[0, 0].get_ylim()
    assert high - low < 2.0


def test_the_view_shows_measured_points_and_dropouts(flight):
    truth_m = np.zeros((*flight.range_m.shape, 3))
    truth_m[..., :2] = np.linspace(-100, 100, truth_m[..., :2].size).reshape(truth_m[..., :2].shape)
    known = replace(flight, true_point_site_m=truth_m, point_site_m=truth_m)
    view = draw_descent(known, None, "a title").axes[0]
    (lost,) = (line for line in view.lines if line.get_marker() == "x")
    assert len(lost.get_data_3d()[0]) == np.count_nonzero(flight.fired & ~flight.range_valid) > 0
    (points,) = (each for each in view.collections if each.get_array() is not None)
    np.testing.assert_array_equal(points.get_array(), flight.range_m[flight.range_valid])


def test_many_beams_share_panels(flight):
    table = {name: getattr(flight, name) for name in COLUMNS}
    many = replace(
        flight,
        **{
            name: np.concatenate([values, values], axis=1)
            for name, values in table.items()
            if not COLUMNS[name].per_shot
        },
    )
    assert error_panels(draw_descent(many, None, "a title")).shape == (1, 2)


def test_ground_is_light_grey_below_the_points(flight, plane, tmp_path):
    with_ground = drawn(flight, plane, tmp_path / "run.png")
    without = drawn(flight, None, tmp_path / "points.png")
    grey = (0.84, 0.84, 0.84)
    assert pixels_of(with_ground[VIEW], grey) > 30_000
    assert pixels_of(without[VIEW], grey) < 3_000
    points = colormaps["viridis"](1.0)
    assert pixels_of(with_ground[VIEW], points) == pytest.approx(pixels_of(without[VIEW], points), rel=0.2)


def test_missing_ground_is_left_out(flight, plane, tmp_path):
    class HalfGround(PlaneGround):
        def height_m(self, east_m, north_m):
            return np.where(east_m < 0, super().height_m(east_m, north_m), np.nan)

    grey = (0.84, 0.84, 0.84)
    whole = pixels_of(drawn(flight, plane, tmp_path / "whole.png")[VIEW], grey)
    half = pixels_of(drawn(flight, HalfGround(0.0, 0.0, 0.0), tmp_path / "half.png")[VIEW], grey)
    assert 0.3 < half / whole < 0.7


def test_no_ground_at_all_is_no_error(flight, tmp_path):
    class NoGround(PlaneGround):
        def height_m(self, east_m, north_m):
            return np.full_like(east_m + north_m, np.nan)

    image = drawn(flight, NoGround(0.0, 0.0, 0.0), tmp_path / "none.png")
    np.testing.assert_array_equal(image, drawn(flight, None, tmp_path / "points.png"))


def test_a_single_point_makes_a_picture(flight, plane, tmp_path):
    one = np.zeros_like(flight.range_valid)
    one[np.unravel_index(flight.range_valid.argmax(), one.shape)] = True
    image = drawn(replace(flight, range_valid=one), plane, tmp_path / "one.png")
    assert pixels_of(image[VIEW], (0.84, 0.84, 0.84)) > 10_000


def test_nothing_to_draw_is_refused(flight, bench, tmp_path):
    with pytest.raises(InputError, match="a bench pattern has no ground to draw"):
        plot_descent(bench, None, "bench", tmp_path / "bench.png")
    with pytest.raises(InputError, match="valid range"):
        plot_descent(
            replace(flight, range_valid=np.zeros_like(flight.range_valid)), None, "run", tmp_path / "run.png"
        )
    assert list(tmp_path.iterdir()) == []


def test_without_matplotlib_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"pip install .*\[plots\]'$"):
        check_plot_path(tmp_path / "run.png")
