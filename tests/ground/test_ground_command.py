"""`lidar-emu ground` as its users see it."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
from matplotlib.image import imread

from lidar_emu import cli
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
    assert run(monkeypatch, *SMALL, "--plot", str(path)) == 0
    output = capsys.readouterr().out
    assert "Hurst exponent of the relief" in output
    assert "outside" not in output
    picture = imread(path)
    assert picture.shape[:2] == (1100, 1600)
    # The relief in low sun: neither blank nor black and white.
    shade = picture[250:800, 200:700, 0]
    assert 0.05 < shade.std() < 0.4


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
        (("descent",), ("descent: site.ground.kind: 'grid'", "allowed: generated")),
        (("bench",), ("bench pattern", "allowed: a flight")),
        ((*SMALL, "--plot", "ground.jpg"), ("ground.jpg", "allowed: .png")),
        ((*SMALL, "--out", "ground.obj"), ("ground.obj", "allowed: .npz, .tif, .asc")),
        ((*SMALL, "--out", "nowhere/ground.npz"), ("nowhere/ground.npz", "no such folder")),
        (
            (*SMALL, "--set", "site.ground.rocks.largest_diameter_m=1"),
            ("rocks.largest_diameter_m: 1", "allowed"),
        ),
    ],
)
def test_what_cannot_be_used_is_one_line(monkeypatch, capsys, words, expected):
    assert run(monkeypatch, *words) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert all(text in line for text in expected)
