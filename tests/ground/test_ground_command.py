"""`lidar-emu ground` as its users see it."""

from __future__ import annotations

import json
import math
import sys

import numpy as np
import pytest
from matplotlib.image import imread
from matplotlib.text import Text

from lidar_emu import cli
from lidar_emu.report import ground_plots
from lidar_emu.report.ground_survey import GroundSurvey
from lidar_emu.scenario.site import Site
from lidar_emu.scene import build_scene

SMALL = ("descent", "--set", "site=cratered", "--set", "site.ground.size_m=512")


def run(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["lidar-emu", "ground", *words])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return ended.value.code or 0


def test_json_compares_and_names_the_file(monkeypatch, capsys, cache):
    assert run(monkeypatch, *SMALL, "--json") == 0
    document = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert document["ground"]["size_m"] == 512
    whole = document["whole_ground"]
    assert whole["lowest_m"] < 0 < whole["highest_m"]
    # Craters add slope to the relief's 2 degrees over 20 m, and the ground is smoother over longer baselines.
    slope_deg = {row["baseline_m"]: row["slope_deg"] for row in whole["rms_slope"]}
    assert list(slope_deg) == [2, 4, 8, 16, 32, 64]
    assert 2.5 < slope_deg[16] < 12
    assert slope_deg[64] < slope_deg[2]
    assert document["kept_in"] == str(next(cache.iterdir()))
    assert all(row["within"] for row in document["statistics"])
    hurst = document["statistics"][0]
    assert hurst["asked"] == 0.76
    assert hurst["low"] <= hurst["found"] <= hurst["high"]


def test_table_and_picture(monkeypatch, capsys, tmp_path):
    path = tmp_path / "ground.png"
    assert run(monkeypatch, *SMALL, "--statistics", str(path)) == 0
    output = capsys.readouterr().out
    assert "Hurst exponent of the relief" in output
    assert "outside" not in output
    picture = imread(path)
    assert picture.shape[:2] == (1408, 1600)
    # The relief in low sun: neither blank nor black and white.
    shade = picture[250:850, 200:800, 0]
    assert 0.05 < shade.std() < 0.4


@pytest.fixture
def drawn(monkeypatch):
    """The figures that commands would write."""
    figures = []
    monkeypatch.setattr(ground_plots, "write_plot", lambda figure, _: figures.append(figure))
    return figures


def texts_of(figure):
    return [text.get_text() for text in figure.findobj(Text)]


def test_the_picture_has_site_and_statistics(monkeypatch, capsys, drawn):
    assert run(monkeypatch, *SMALL, "--statistics", "a.png", "--json") == 0
    statistics = json.loads(capsys.readouterr().out)["statistics"]
    texts = texts_of(drawn[0])
    assert drawn[0].get_suptitle().startswith("Cratered: generated ground, 512 m")
    for row in statistics:
        at = texts.index(row["quantity"])
        assert [float(text) for text in texts[at + 1 : at + 3]] == pytest.approx(
            [row["asked"], row["found"]], rel=1e-3
        )
    assert not any("^{" in text for text in texts)


def test_the_survey_names_what_it_draws(monkeypatch, drawn):
    """A vertical path is a point on the map; arrows of colour bars mark values beyond them."""
    for scenario, has_path in (("descent", False), ("powered_descent", True)):
        assert run(monkeypatch, scenario, "--plot", "a.png") == 0
        figure = drawn.pop()
        assert ("path" in texts_of(figure)) is has_path
        panels = [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]
        assert all(axes.get_title("left") for axes in panels)
        (slopes,) = panels[1].images
        assert slopes.colorbar.extend == (
            "max" if slopes.get_array().max() > slopes.get_clim()[1] else "neither"
        )


def test_edges_and_holes_of_a_ground_have_no_slope():
    """A plane of 7 degrees whose corner, in differences along the edge alone, is 50 m too high, with one hole."""
    place_m = np.arange(9.0)
    up_m = math.tan(math.radians(7)) * np.repeat(place_m[:, None], 9, axis=1)
    up_m[0, 0] += 50.0
    up_m[4, 4] = np.nan
    slope_deg = GroundSurvey("", place_m, place_m, up_m, None).slope_deg
    known = slope_deg[np.isfinite(slope_deg)]
    assert known == pytest.approx(np.full(7 * 7 - 5, 7.0))


def survey(monkeypatch, capsys, *words):
    assert run(monkeypatch, *words, "--json") == 0
    return json.loads(capsys.readouterr().out, parse_constant=pytest.fail)["survey"]


def test_a_plane_has_one_slope_and_the_footprint_of_trigonometry(monkeypatch, capsys):
    slope = "site.ground={kind: plane, slope_deg: 7, downhill_azimuth_deg: 30}"
    found = survey(monkeypatch, capsys, "descent", "--set", "site=flat", "--set", slope)
    assert found["slope_deg"] == pytest.approx({"median": 7, "p95": 7, "largest": 7}, abs=1e-6)
    level = survey(monkeypatch, capsys, "descent", "--set", "site=flat")
    # Four beams at 22.5 degrees, on the diagonals, from 2000 m.
    reach_m = 2000 * math.tan(math.radians(22.5)) / math.sqrt(2)
    assert level["footprint"]["area_m"] == pytest.approx(
        {"west_m": -reach_m, "east_m": reach_m, "south_m": -reach_m, "north_m": reach_m}, abs=1
    )
    assert level["footprint"]["incidence_deg"]["largest"] == pytest.approx(22.5, abs=1e-6)
    assert (level["footprint"]["no_ground_share"], level["missing_share"]) == (0, 0)
    assert level["area_m"]["east_m"] == pytest.approx(1.5 * reach_m, abs=2)


def test_a_cube_is_surveyed_over_its_sides(monkeypatch, capsys, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box((40.0, 20.0, 6.0)).export(tmp_path / "box.ply")
    ground = f"site.ground={{kind: mesh, file: {tmp_path / 'box.ply'}, unit: m}}"
    words = ("--set", "site=flat", "--set", ground, "--set", "trajectory.waypoints.1.altitude_m=100")
    found = survey(monkeypatch, capsys, "descent", *words)
    assert "closed, volume 4800 m³, radii 22.56 to 22.56 m" in found["description"]
    assert found["area_m"] == pytest.approx({"west_m": -20, "east_m": 20, "south_m": -10, "north_m": 10})
    # The lattice ends on the box's edges, where the top is barely missed.
    assert found["highest_m"] == pytest.approx(3.0)
    assert found["footprint"]["no_ground_share"] > 0.5


def test_a_grid_is_surveyed_at_its_samples(monkeypatch, capsys, tmp_path):
    height_m = np.zeros((41, 61))
    height_m[20, 30], height_m[3, 5] = 8.0, np.nan
    np.savez(tmp_path / "spike.npz", elevation_m=height_m, pixel_m=2.0)
    ground = f"site.ground={{kind: grid, file: {tmp_path / 'spike.npz'}, beyond: none}}"
    found = survey(monkeypatch, capsys, "live", "--set", ground)
    assert found["area_m"] == {"west_m": -60, "east_m": 60, "south_m": -40, "north_m": 40}
    assert found["sampled_every_m"] == [2, 2]
    # The spike is the origin, and altitudes count from there.
    assert (found["lowest_m"], found["highest_m"]) == (-8, 0)
    assert found["slope_deg"]["largest"] == pytest.approx(math.degrees(math.atan(8 / 4)))
    # The sample itself, and of its neighbours those whose cell it belongs to.
    assert 1 <= round(found["missing_share"] * height_m.size) <= 4
    assert found["footprint"] is None


@pytest.mark.slow
@pytest.mark.parametrize("words", [("descent",), ("live",), ("descent", "--set", "site=flat"), SMALL])
def test_any_ground_is_drawn(monkeypatch, capsys, tmp_path, words):
    path = tmp_path / "survey.png"
    assert run(monkeypatch, *words, "--plot", str(path)) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == str(path)
    assert any(line.startswith("slope over ") and "95th percentile" in line for line in lines)
    picture = imread(path)
    assert picture.shape[:2] == (1408, 1600)
    # The map of heights is coloured.
    assert picture[200:550, 200:550, :3].std(axis=-1).max() > 0.1


@pytest.mark.parametrize("suffix", [".npz", ".tif", ".asc"])
def test_exported_ground_is_the_same_ground(monkeypatch, capsys, tmp_path, suffix):
    path = tmp_path / f"ground{suffix}"
    assert run(monkeypatch, *SMALL, "--out", str(path), "--json") == 0
    asked = json.loads(capsys.readouterr().out)["ground"]
    made = build_scene(Site.model_validate({"ground": asked}))
    read = build_scene(Site.model_validate({"ground": {"kind": "grid", "file": str(path)}}))
    np.testing.assert_allclose(read.samples.height_m, made.samples.height_m, rtol=0, atol=1e-5)
    assert (read.samples.west_m, read.samples.south_m) == (-256.0, -256.0)
    assert read.samples.pixel_east_m == made.samples.pixel_east_m == 2.0
    at_map = {"map_x_m": 100.0, "map_y_m": -30.0}
    moved = build_scene(
        Site.model_validate({"ground": {"kind": "grid", "file": str(path), "origin": at_map}})
    )
    assert moved.samples.west_m == -356.0


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (
            ("descent", "--out", "ground.npz"),
            ("site.ground.kind: a ground of kind grid", "--out", "generated"),
        ),
        (
            ("descent", "--statistics", "a.png"),
            ("ground of kind grid", "--statistics needs a generated ground"),
        ),
        (("bench",), ("bench pattern", "name a flight")),
        ((*SMALL, "--statistics", "ground.jpg"), ("ground.jpg", "use .png")),
        ((*SMALL, "--plot", "ground.jpg"), ("ground.jpg", "use .png")),
        ((*SMALL, "--out", "ground.obj"), ("ground.obj", "use .npz, .tif, .asc")),
        ((*SMALL, "--out", "nowhere/ground.npz"), ("nowhere/ground.npz", "no such folder")),
        (
            (*SMALL, "--set", "site.ground.rocks.largest_diameter_m=1"),
            ("rocks.largest_diameter_m: must be", "(got 1"),
        ),
    ],
)
def test_what_cannot_be_used_is_one_line(monkeypatch, capsys, words, expected):
    assert run(monkeypatch, *words) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert all(text in line for text in expected)
