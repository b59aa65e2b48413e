"""`lidar-emu detection` as its users see it."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from matplotlib.image import imread

from lidar_emu import cli


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


def test_table_fits_a_terminal(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    assert run(monkeypatch, "descent") == 0
    printed = capsys.readouterr().out
    rows = [line.split() for line in printed.splitlines() if line.strip().startswith(("7.5 ", "22.5 "))]
    assert len(rows) == 32
    assert {len(row) for row in rows} == {11}
    assert "…" not in printed
    assert "1.89 dB" in printed


@pytest.mark.slow
def test_picture(monkeypatch, capsys, tmp_path):
    path = tmp_path / "detection.png"
    assert run(monkeypatch, "descent", "--plot", str(path)) == 0
    assert capsys.readouterr().out == f"{path}: descent\n"
    image = imread(path)
    assert image.shape[:2] == (1100, 1600)
    blue = abs(image[..., :3] - (0x1F / 255, 0x77 / 255, 0xB4 / 255)).max(axis=-1) < 0.02
    assert blue.sum() > 1000


def test_picture_and_json_together(monkeypatch, capsys, tmp_path):
    path = tmp_path / "detection.png"
    assert document(monkeypatch, capsys, "descent", "--plot", str(path))["rows"]
    assert path.exists()


ALTITUDES = "must be LOW:HIGH in metres"


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["bench"], ("bench: a bench pattern", "name a flight")),
        (["missing.yaml"], ("missing.yaml: no such file",)),
        (["descent", "--altitudes", "10"], ("--altitudes: ", "(got '10')", ALTITUDES)),
        (["descent", "--altitudes", "low:high"], ("--altitudes: ", "(got 'low:high')", ALTITUDES)),
        (["descent", "--altitudes", "100:10"], ("--altitudes: ", "(got '100:10')", ALTITUDES)),
        (["descent", "--altitudes", "0:10"], ("--altitudes: ", "(got '0:10')", ALTITUDES)),
        (["descent", "--altitudes", "10:inf"], ("--altitudes: ", "(got '10:inf')", ALTITUDES)),
        (["descent", "--altitudes", "nan:nan"], ("--altitudes: ", "(got 'nan:nan')", ALTITUDES)),
        (["descent", "--altitudes", "1:2:3"], ("--altitudes: ", "(got '1:2:3')", ALTITUDES)),
        (["descent", "--set", "seed"], ("--set: ", "(got 'seed')", "KEY=VALUE")),
        (["descent", "--plot", "out.jpg"], ("out.jpg", ".png")),
        (["descent", "--plot", "out.png", "--altitudes", "2e4:3e4"], ("no beam with an echo", "maximum_range_m")),
        (["descent", "--set", "instrument.receiver.responsivity_a_per_w=2"], ("responsivity_a_per_w", "at most 1.25")),
    ],
)  # fmt: skip
def test_refused_in_one_line(words, expected, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, *words) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("lidar-emu: ")
    assert printed.err.count("\n") == 1
    for part in expected:
        assert part in printed.err
    assert list(tmp_path.iterdir()) == []


def test_help_has_examples_and_loads_nothing_heavy():
    code = (
        "import sys; sys.argv = ['lidar-emu', 'detection', '--help']\n"
        "from lidar_emu.cli import main\n"
        "try: main()\n"
        "except SystemExit as end: assert not end.code, end.code\n"
        "heavy = {'numba', 'numpy', 'scipy', 'matplotlib', 'pydantic', 'rich'}\n"
        "print('loaded:', sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "loaded: []"
    assert "lidar-emu detection descent.yaml --altitudes 100:5000" in done.stdout
