"""The picture of a descent, judged by its pixels."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.image import imread

from lidar_emu import files
from lidar_emu.errors import InputError
from lidar_emu.report.descent_plot import plot_descent
from lidar_emu.report.png_file import check_plot_path
from lidar_emu.scene.plane import PlaneGround

pytestmark = pytest.mark.slow

LEFT, RIGHT = np.s_[60:680, 0:690], np.s_[60:680, 800:1490]
"""The panels without their colour bars."""
ERRORS = np.s_[720:1040, 90:1470]


@pytest.fixture
def plane():
    return PlaneGround(0.0, 0.0, 0.0)


def drawn(measurement, scene, path):
    plot_descent(measurement, scene, "a title", path)
    image = imread(path)
    assert image.shape[:2] == (1100, 1600)
    return image[..., :3]


def pixels_of(image, colour):
    """How many pixels have just this colour."""
    return int((np.abs(image - np.array(colour)[:3]).max(axis=-1) < 0.02).sum())


def test_each_panel_has_the_colours_of_its_quantity(flight, plane, tmp_path):
    image = drawn(flight, plane, tmp_path / "run.png")
    for panel, own, other in ((LEFT, "viridis", "plasma"), (RIGHT, "plasma", "viridis")):
        for share in (0.0, 0.5, 1.0):
            assert pixels_of(image[panel], colormaps[own](share)) > 10
            assert pixels_of(image[panel], colormaps[other](share)) < 10


def test_ground_is_light_grey_below_the_points(flight, plane, tmp_path):
    with_ground = drawn(flight, plane, tmp_path / "run.png")
    without = drawn(flight, None, tmp_path / "points.png")
    grey = (0.84, 0.84, 0.84)
    assert pixels_of(with_ground[LEFT], grey) > 30_000
    assert pixels_of(without[LEFT], grey) < 3_000
    points = colormaps["viridis"](1.0)
    assert pixels_of(with_ground[LEFT], points) == pytest.approx(pixels_of(without[LEFT], points), rel=0.2)


def test_missing_ground_is_left_out(flight, plane, tmp_path):
    class HalfGround(PlaneGround):
        def height_m(self, east_m, north_m):
            return np.where(east_m < 0, super().height_m(east_m, north_m), np.nan)

    grey = (0.84, 0.84, 0.84)
    whole = pixels_of(drawn(flight, plane, tmp_path / "whole.png")[LEFT], grey)
    half = pixels_of(drawn(flight, HalfGround(0.0, 0.0, 0.0), tmp_path / "half.png")[LEFT], grey)
    assert 0.3 < half / whole < 0.7


def test_no_ground_at_all_is_no_error(flight, tmp_path):
    class NoGround(PlaneGround):
        def height_m(self, east_m, north_m):
            return np.full_like(east_m + north_m, np.nan)

    image = drawn(flight, NoGround(0.0, 0.0, 0.0), tmp_path / "none.png")
    np.testing.assert_array_equal(image, drawn(flight, None, tmp_path / "points.png"))


def test_errors_show_each_beam_that_measured(flight, tmp_path):
    silent = np.array([True, True, False, True])
    muted = replace(flight, range_valid=flight.range_valid & silent, speed_valid=flight.speed_valid & silent)
    image = drawn(muted, None, tmp_path / "run.png")[ERRORS]
    tab10 = colormaps["tab10"].colors
    assert [pixels_of(image, tab10[beam]) > 50 for beam in range(4)] == silent.tolist()


def test_a_single_point_makes_a_picture(flight, plane, tmp_path):
    one = np.zeros_like(flight.range_valid)
    one[np.unravel_index(flight.range_valid.argmax(), one.shape)] = True
    image = drawn(replace(flight, range_valid=one), plane, tmp_path / "one.png")
    assert pixels_of(image[LEFT], (0.84, 0.84, 0.84)) > 10_000


def test_nothing_to_draw_is_refused(flight, bench, tmp_path):
    with pytest.raises(InputError, match="a bench pattern has no ground to draw"):
        plot_descent(bench, None, "bench", tmp_path / "bench.png")
    with pytest.raises(InputError, match="valid range"):
        plot_descent(
            replace(flight, range_valid=np.zeros_like(flight.range_valid)), None, "run", tmp_path / "run.png"
        )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "message"), [("run.pdf", r"allowed: \.png"), ("nowhere/run.png", "no such folder")]
)
def test_unusable_plot_paths_are_refused_early(tmp_path, name, message):
    with pytest.raises(InputError, match=message):
        check_plot_path(tmp_path / name)


def test_without_matplotlib_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"pip install 'lidar-emu\[plots\]'"):
        check_plot_path(tmp_path / "run.png")
