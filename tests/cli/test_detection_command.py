"""`lidar-emu detection` as its users see it."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
from matplotlib.image import imread

from lidar_emu import cli
from lidar_emu.report.beam_colours import beam_rgb


def run(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["lidar-emu", "detection", *words])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return ended.value.code or 0


def document(monkeypatch, capsys, *words):
    assert run(monkeypatch, *words, "--json") == 0
    return json.loads(capsys.readouterr().out, parse_constant=pytest.fail)


def test_json_has_a_row_per_angle_and_altitude(monkeypatch, capsys):
    forecast = document(monkeypatch, capsys, "descent", "--altitudes", "100:11900")
    rows = forecast["rows"]
    assert {row["angle_deg"] for row in rows} == {7.5, 22.5}
    altitudes_m = [row["altitude_m"] for row in rows if row["angle_deg"] == 7.5]
    assert altitudes_m[0] == pytest.approx(100)
    assert altitudes_m[-1] == pytest.approx(11_900)
    assert altitudes_m[1] / altitudes_m[0] == pytest.approx(altitudes_m[-1] / altitudes_m[-2])
    for row in rows:
        beyond = row["range_m"] is None
        assert (
            beyond == (row["altitude_m"] > 11_000 and row["angle_deg"] == 22.5) or row["altitude_m"] > 11_800
        )
        assert all(
            (value is None) == beyond
            for name, value in row.items()
            if name not in ("angle_deg", "altitude_m")
        )
    assert (forecast["site"], forecast["rule"], forecast["looks"]) == ("mare", "all_three", 1)


def test_settings_count(monkeypatch, capsys):
    base = document(monkeypatch, capsys, "descent", "--altitudes", "1000:2000")["rows"][0]["snr_db"]
    weak = document(
        monkeypatch,
        capsys,
        "descent",
        "--altitudes",
        "1000:2000",
        "--set",
        "instrument.optics.laser_power_w=0.1",
    )
    assert weak["rows"][0]["snr_db"] == pytest.approx(base - 10, abs=1e-9)


def test_a_black_ground_is_null_in_json(monkeypatch, capsys):
    rows = document(monkeypatch, capsys, "descent", "--set", "site.surface.reflectance=0")["rows"]
    assert rows[0]["snr_db"] is None
    assert rows[0]["segment_steady"] == pytest.approx(1e-3 / 2**16)


@pytest.mark.slow
def test_picture(monkeypatch, capsys, tmp_path):
    dark, path = tmp_path / "detection-dark.png", tmp_path / "detection.png"
    assert run(monkeypatch, "descent", "--plot", str(dark), "--plot", str(path)) == 0
    assert capsys.readouterr().out == f"{dark}: descent\n{path}: descent\n"
    assert imread(dark).shape == imread(path).shape
    assert imread(dark)[..., :3].mean() < 0.2 < 0.8 < imread(path)[..., :3].mean()
    image = imread(path)
    assert image.shape[:2] == (1100, 1600)
    blue = abs(image[..., :3] - np.array(beam_rgb(0)) / 255).max(axis=-1) < 0.02
    assert blue.sum() > 1000


@pytest.mark.parametrize("angles_deg", [[22.5], [0, 4, 8]])
def test_picture_and_json_together(angles_deg, monkeypatch, capsys, tmp_path):
    path = tmp_path / "detection.png"
    beams = [[angle_deg, 0] for angle_deg in angles_deg]
    pattern = f"scanner={{pattern: {{kind: directions, beams: {beams}}}}}"
    assert document(monkeypatch, capsys, "descent", "--set", pattern, "--plot", str(path))["rows"]
    assert (imread(path)[:, -3:] == 1).all(), "a legend is cut off at the right edge"
