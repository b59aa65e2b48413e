"""The picture of a descent: its contents against the measurement, and the ground by its pixels."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import PathCollection
from matplotlib.colors import to_hex
from matplotlib.image import imread
from matplotlib.text import Text

import lidar_emu
from lidar_emu import files
from lidar_emu.errors import InputError
from lidar_emu.measurement import COLUMNS
from lidar_emu.report.beam_colours import beam_colour
from lidar_emu.report.descent_plot import draw_descent, plot_descent, title_of
from lidar_emu.report.ground_survey import hill_shade
from lidar_emu.report.oblique_view import ObliqueView
from lidar_emu.report.plot_style import check_plot_path
from lidar_emu.scene.analytic_grounds import PlaneGround

pytestmark = pytest.mark.slow

VIEW = np.s_[80:960, 0:700]
"""The view of the ground."""
LEVEL_GREY = (0.688, 0.688, 0.688)


@pytest.fixture
def plane():
    return PlaneGround(0.0, 0.0, 0.0)


def drawn(measurement, scene, path):
    plot_descent(measurement, scene, "a title", path)
    image = imread(path)
    assert image.shape[:2] == (1104, 1600)
    return image[..., :3]


def pixels_of(image, colour):
    """How many pixels have just this colour."""
    return int((np.abs(image - np.array(colour)[:3]).max(axis=-1) < 0.02).sum())


def error_panels(figure):
    """Return the panels of errors, (beams, 2); in the figure they follow the view and the panels of values."""
    return np.array(figure.axes[1:]).reshape(-1, 2)[1:]


def points_of(axes):
    """The points of the measurement on axes, a scatter."""
    (drawn,) = (each for each in axes.collections if isinstance(each, PathCollection))
    return drawn


def test_every_measurement_is_drawn_once(flight):
    """Each beam has panels of its own, in which every valid error and every dropout has a mark."""
    panels = error_panels(draw_descent(flight, None, "a title"))
    assert panels.shape == (flight.beam_count, 2)
    for column, (valid, error) in enumerate((
        (flight.range_valid, flight.range_m - flight.true_range_m),
        (flight.speed_valid, 1e3 * (flight.closing_speed_mps - flight.true_closing_speed_mps)),
    )):  # fmt: skip
        for beam, axes in enumerate(panels[:, column]):
            shown = points_of(axes).get_offsets().data
            np.testing.assert_array_equal(np.sort(shown[:, 1]), np.sort(error[valid[:, beam], beam]))
            assert {to_hex(each) for each in points_of(axes).get_facecolors()} == {beam_colour(beam)}
            (lost,) = (line for line in axes.lines if line.get_marker() == "|")
            lost_s = flight.time_s[flight.fired[:, beam] & ~valid[:, beam], beam]
            np.testing.assert_array_equal(lost.get_xdata(), lost_s)


def test_each_of_four_equal_beams_is_seen(flight):
    """The beams have one range: a quarter of the shots shows each, as the last point drawn there."""
    every = np.ones_like(flight.range_valid)
    same = replace(flight, range_m=flight.true_range_m, range_valid=every, fired=every)
    drawn = points_of(draw_descent(same, None, "a title").axes[1])
    colours = map(to_hex, drawn.get_facecolors())
    on_top = dict(zip(drawn.get_offsets().data[:, 0].tolist(), colours, strict=True))
    assert len(on_top) == len(flight)
    counts = [list(on_top.values()).count(beam_colour(beam)) for beam in range(4)]
    assert min(counts) > 0.2 * len(flight)


def test_heights_along_the_path_are_those_of_the_path(flight):
    """A vertical path, whose ends are known: heights are linear between them in any parallel projection."""
    view = draw_descent(flight, None, "a title").axes[0]
    (path,) = (line for line in view.lines if line.get_label().startswith("path"))
    first, last = path.get_xydata()[[0, -1]]
    labels = [text for text in view.texts if text.get_text().endswith(" m")]
    assert {text.get_text() for text in labels} >= {"1000 m", "800 m"}
    for text in labels:
        share = (1000.0 - float(text.get_text()[:-2])) / 800.0
        np.testing.assert_allclose(text.xy, first + share * (last - first), rtol=1e-9, atol=1e-9)


def test_moving_objects_are_named_where_they_are_seen(flight):
    at_m = np.where(np.isfinite(flight.point_site_m), flight.point_site_m, 0.0)
    seen = np.zeros(flight.range_m.shape, dtype=np.int16)
    seen[10, 2] = 3
    valid = np.ones_like(flight.range_valid)
    met = replace(flight, true_object=seen, point_site_m=at_m, range_valid=valid, speed_valid=valid)
    figure = draw_descent(met, None, "a title", moving={3: "rover", 4: "drone"})
    view, speed = figure.axes[0], figure.axes[2]
    (label,) = (text for text in view.texts if text.get_text() == "rover")
    np.testing.assert_allclose(label.xy, ObliqueView.around(met).project(at_m[10, 2]))
    (label,) = (text for text in speed.texts if text.get_text().startswith("rover"))
    assert label.xy == (flight.time_s[10, 2], met.closing_speed_mps[10, 2])
    assert not any("drone" in text.get_text() for text in figure.findobj(Text))


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
    assert len(lost.get_xdata()) == np.count_nonzero(flight.fired & ~flight.range_valid) > 0
    shown = {
        to_hex(line.get_color()): len(line.get_xdata()) for line in view.lines if line.get_marker() == "."
    }
    assert shown == {
        beam_colour(beam): flight.range_valid[:, beam].sum() for beam in range(flight.beam_count)
    }


def test_the_projection_is_an_orthogonal_one(flight):
    """Rows of an orthogonal projection are perpendicular and of unit length; heights stay vertical."""
    view = ObliqueView.around(flight)
    rows = view.project(np.eye(3)).T
    np.testing.assert_allclose(rows @ rows.T, np.eye(2), atol=1e-12)
    assert rows[0, 2] == 0.0
    assert rows[1, 2] > 0.0


def test_a_ridge_casts_its_shadow_away_from_the_sun():
    """The ridge runs from south-west to north-east over level ground; the sun is in the north-west."""
    east_m, north_m = np.meshgrid(np.arange(60.0), np.arange(60.0))
    up_m = 5.0 * np.exp(-(((east_m - north_m) / 4.0) ** 2))
    light = hill_shade(np.stack([east_m, north_m, up_m], axis=-1))
    sunny, shadowed = light[33, 30], light[29, 32]
    assert sunny > 0.9
    assert shadowed < 0.3
    assert light[50, 10] == pytest.approx(0.6, abs=1e-3)
    assert light[5, 55] == pytest.approx(0.6, abs=1e-3)


def test_the_title_says_what_is_flown(flight):
    assert title_of(flight, "a_flight") == "a flight from 1000 m to 200 m: 4 beams at 20°"
    changed = flight.beam_angle_deg.copy()
    changed[20:] = 7.5
    pattern = (np.arange(len(flight)) >= 20).astype(np.uint8)
    up_m = flight.position_site_m[19:21, 2]
    assert up_m[1] < 600.0 < up_m[0]
    switched = replace(flight, pattern=pattern, beam_angle_deg=changed)
    assert title_of(switched, "descent").endswith(": 4 beams at 20°, 7.5° below 600 m")


def test_faults_and_changes_of_the_pattern_are_marked(flight):
    faults = lidar_emu.load(
        "descent.yaml", {"faults": "[{kind: dropout, from_s: 0.5, to_s: 1}, {kind: lost, at_s: 1.5}]"}
    ).faults
    pattern = (np.arange(len(flight)) >= 20).astype(np.uint8)
    figure = draw_descent(replace(flight, pattern=pattern), None, "a title", faults)
    for axes in figure.axes[1:]:
        (span,) = (patch for patch in axes.patches)
        assert (span.get_x(), span.get_x() + span.get_width()) == pytest.approx((0.5, 1.0))
        upright = {
            line.get_xdata()[0]
            for line in axes.lines
            if len(set(line.get_xdata())) == 1 and line.get_linestyle() != "None"
        }
        assert upright == {1.5, flight.time_s[20, 0]}
    (words,) = {text.get_text() for text in figure.findobj(Text) if text.get_text().startswith("fault")}
    assert words == "fault: dropout, lost"


def repeated(flight, times):
    """The flight with each beam several times."""
    table = {name: getattr(flight, name) for name in COLUMNS if not COLUMNS[name].per_shot}
    return replace(
        flight, **{name: np.concatenate([values] * times, axis=1) for name, values in table.items()}
    )


def test_many_beams_share_panels(flight):
    figure = draw_descent(repeated(flight, 2), None, "a title")
    assert error_panels(figure).shape == (1, 2)
    assert {f"beam {each}" for each in range(8)} < {text.get_text() for text in figure.findobj(Text)}


def test_points_of_very_many_beams_have_the_colour_of_their_height(flight):
    many = repeated(flight, 5)
    figure = draw_descent(many, None, "a title")
    bar = next(axes for axes in figure.axes if axes.get_xlabel().startswith("colour of all points: height"))
    height_m = many.point_site_m[many.range_valid, 2]
    assert bar.get_xlim() == pytest.approx((height_m.min(), height_m.max()))
    errors = [axes for axes in figure.axes if axes.get_xlabel() == "time (s)"]
    np.testing.assert_array_equal(np.sort(points_of(errors[0]).get_array()), np.sort(height_m))


def test_ground_is_grey_below_the_points(flight, plane, tmp_path):
    with_ground = drawn(flight, plane, tmp_path / "run.png")
    without = drawn(flight, None, tmp_path / "points.png")
    assert pixels_of(with_ground[VIEW], LEVEL_GREY) > 20_000
    assert pixels_of(without[VIEW], LEVEL_GREY) < 1_000


def test_missing_ground_is_left_out(flight, plane, tmp_path):
    class HalfGround(PlaneGround):
        def height_m(self, east_m, north_m):
            return np.where(east_m < 0, super().height_m(east_m, north_m), np.nan)

    grey = LEVEL_GREY
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
    assert pixels_of(image[VIEW], LEVEL_GREY) > 10_000


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
