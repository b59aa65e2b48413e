"""A sensor fitted from logs of imagined sensors, whose properties are known, and from a real one."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.stats import binom
from synthetic_logs import Floats, KnownSensor, drawn_sensor, synthetic_log
from twins import NEW_SHEPARD

from benchmarks.fit_coverage import intervals
from lidar_emu.cli import cli
from lidar_emu.errors import InputError
from lidar_emu.recording.read import Recording
from lidar_emu.sensor_fit.flight_log import FlightLog, read_log
from lidar_emu.sensor_fit.reference import track
from lidar_emu.sensor_fit.validation import Fit, characterised, fit_log

NS13 = {
    "time_ns": "TIME_NANOSECONDS_TAI",
    "range_m": "OMPS_Range_M[*]",
    "closing_speed_mps": "OMPS_DopplerSpeed_MpS[*]",
}


def log_of(columns: dict[str, Floats]) -> FlightLog:
    return FlightLog("log", **columns)


def without_truth(columns: dict[str, Floats]) -> dict[str, Floats]:
    return {
        name: np.full_like(each, np.nan) if name.startswith("true_") else each
        for name, each in columns.items()
    }


def figures(columns: dict[str, Floats]) -> dict[str, tuple[float, float, float]]:
    return {row.what: tuple(row.estimate) for row in characterised(log_of(columns), 2.0).rows}


def outside(fit: Fit) -> list[str]:
    return [check.what for check in fit.checks if not check.inside]


def written(path: Path, columns: dict[str, Floats], shape: str) -> Path:
    """A CSV file with a row per shot and beam, or with columns for each beam."""
    shots, beams = columns["range_m"].shape
    if shape == "rows":
        names = ["shot", "beam", *columns]
        shot, beam = np.divmod(np.arange(shots * beams), beams)
        table = np.column_stack([shot, beam, *(each.ravel() for each in columns.values())])
    else:
        names = [f"{name}_{beam}" for name in columns for beam in range(beams)]
        table = np.column_stack(list(columns.values()))
    rows = [",".join("" if np.isnan(cell) else repr(float(cell)) for cell in row) for row in table]
    path.write_text("\n".join([",".join(names), *rows]) + "\n")
    return path


@pytest.mark.parametrize("shape", ["rows", "columns"])
def test_a_file_is_read_as_it_was_written(tmp_path: Path, shape: str) -> None:
    columns = synthetic_log(replace(drawn_sensor(1), dropout_probability=0.1), 1, 20.0, beams=3)
    log = read_log(written(tmp_path / "log.csv", columns, shape), {})
    for name, values in columns.items():
        np.testing.assert_allclose(getattr(log, name), values, atol=1e-9, err_msg=name)


def test_without_flags_a_zero_is_no_value(tmp_path: Path) -> None:
    columns = synthetic_log(KnownSensor(), 1, 20.0)
    columns["range_m"][50:60], columns["closing_speed_mps"][70:90] = 0.0, 0.0
    log = read_log(written(tmp_path / "log.csv", columns, "columns"), {})
    assert np.flatnonzero(np.isnan(log.range_m)).tolist() == list(range(50, 60))
    assert np.flatnonzero(np.isnan(log.closing_speed_mps)).tolist() == list(range(70, 90))


@pytest.mark.parametrize(
    ("text", "named", "words"),
    [
        (
            "a,b\n1,2\n",
            {},
            "no column time_s or time_ns; name it with --column time_s=NAME; the file has a, b",
        ),
        ("time_s,range_m\n1,2,3\n", {}, "line 2: 3 cells; write 2, as in the header"),
        ("time_s,range_m\n", {}, "0 shots with a time"),
        ("time_s,range_m,range_m\n1,2,3\n", {}, "range_m: two columns of that name; name each column once"),
        ("time_s,R[1]\n1,2\n", {"range_m": "r[*]"}, "range_m: no column r[*]; did you mean R[1]?"),
        ("time_s,range_m\n" + "1,2\n" * 50, {}, "50 shots with a time; a fit needs 100 or more"),
        ("time_s,range_m\n" + "1,2\n" * 100, {}, "time does not ascend after shot 0"),
        ("time_s,range_m\n1,far\n", {}, "cells must be numbers, or empty"),
        ("time_s,range_m\n" + "".join(f"{k},0\n" for k in range(100)), {}, "no valid range"),
        ("time_s,range_m\n" + "".join(",5\n" for k in range(100)), {}, "0 shots with a time"),
        (
            "time_s,beam,shot,range_m\n" + "".join(f"{k},{k},{k},5\n" for k in range(200)),
            {},
            "200 shots of 200",
        ),
        ("time_s,range_m_0,range_m_1,snr_db_0,snr_db_1,snr_db_2\n1,1,1,1,1,1\n", {}, "snr_db: 3 columns"),
    ],
)
def test_a_file_that_cannot_be_used(tmp_path: Path, text: str, named: dict[str, str], words: str) -> None:
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(InputError) as refusal:
        read_log(tmp_path / "log.csv", named)
    assert words in str(refusal.value)


def test_steps_and_limits() -> None:
    sensor = KnownSensor(range_step_m=0.0625, speed_step_mps=1 / 256, highest_speed_mps=20.0)
    for columns in (synthetic_log(sensor, 3), without_truth(synthetic_log(sensor, 3))):
        found = figures(columns)
        assert found["range step"][0] == pytest.approx(0.0625)
        assert found["speed step"][0] == pytest.approx(1 / 256)
        _, low, high = found["highest speed"]
        assert low <= 20.0 <= high < 20.5
        # The descent never recedes fast: its lowest speed is no limit of the sensor.
        assert np.isnan(found["lowest speed"][1:]).all()
    assert np.isnan(figures(synthetic_log(KnownSensor(), 3))["range step"]).all()


@pytest.mark.parametrize("with_truth", [True, False])
def test_intervals_hold_the_truth(with_truth: bool) -> None:
    """Of twelve drawn sensors; benchmarks/fit_coverage.py counts those of two hundred, figure by figure."""
    held = [
        found.low <= true <= found.high
        for seed in range(12)
        for _, found, true in intervals(seed, with_truth)
    ]
    # Intervals of a log share its noise, so that as many as a fourth of them would be independent.
    trials = len(held) // 4
    assert binom.ppf(1e-4, trials, 0.9) <= np.mean(held) * trials
    assert len(held) > 300


def test_a_sensor_as_fitted_is_inside_the_bands_and_a_noisier_half_is_not() -> None:
    columns = without_truth(synthetic_log(replace(drawn_sensor(4), false_probability=0.0), 4, beams=2))
    as_fitted = outside(fit_log(log_of(columns), 2.0))
    assert len(as_fitted) <= 3
    held_out = np.floor(columns["time_s"] / 2.0) % 2 == 1
    noise_m = 2.0 * np.random.default_rng(1).standard_normal(held_out.shape)
    columns["range_m"] = columns["range_m"] + np.where(held_out, noise_m, 0.0)
    noisier = outside(fit_log(log_of(columns), 2.0))
    assert {"range noise, area metric", "range noise, share inside the 90 % band"} <= set(noisier)
    assert not any(what.startswith("speed noise, area") for what in noisier)


def test_a_half_with_dropouts_is_outside() -> None:
    columns = without_truth(synthetic_log(KnownSensor(), 5))
    held_out = np.floor(columns["time_s"] / 2.0) % 2 == 1
    lost = held_out & (np.random.default_rng(1).random(held_out.shape) < 0.3)
    columns["range_m"] = np.where(lost, np.nan, columns["range_m"])
    assert any(what.startswith("ranges per shot") for what in outside(fit_log(log_of(columns), 2.0)))


def test_noise_that_depends_on_the_noise_before_is_seen() -> None:
    columns = synthetic_log(KnownSensor(range_scale_m=1e-3), 6)
    white = np.random.default_rng(2).standard_normal(len(columns["range_m"]) + 1)
    columns["range_m"] = columns["range_m"] + 0.3 * (white[1:] + 0.8 * white[:-1])[:, None]
    assert "range noise, correlation from shot to shot" in outside(fit_log(log_of(columns), 2.0))


def test_a_reflection_that_stands_still_before_the_ground_is_found_is_no_track() -> None:
    """As many shots as the descent itself, and random ranges between."""
    rng = np.random.default_rng(7)
    time_s = np.arange(400) / 10
    true_m = 800 - 18 * time_s
    range_m = true_m + 0.2 * rng.standard_normal(400)
    range_m[:150] = np.where(
        rng.random(150) < 0.5, rng.uniform(0, 5000, 150), 23 + 0.1 * rng.standard_normal(150)
    )
    found = track(time_s, range_m)
    assert found[155:].mean() > 0.98
    assert found[:145].mean() < 0.05


@pytest.mark.parametrize("change", ["no speed", "one place", "no range after the first half"])
def test_logs_that_cannot_say_much(change: str) -> None:
    columns = without_truth(synthetic_log(KnownSensor(), 8, 60.0))
    if change == "no speed":
        columns["closing_speed_mps"] = np.full_like(columns["closing_speed_mps"], np.nan)
    elif change == "one place":
        columns["range_m"], columns["closing_speed_mps"] = (np.full((600, 1), value) for value in (50.0, 0.1))
    else:
        columns["range_m"][300:] = np.nan
    fit = fit_log(log_of(columns), 2.0)
    rows = {row.what: row for row in fit.sensor.rows}
    assert np.isnan(rows["speed against range rate latency"].estimate.low)
    assert rows["speed against range rate latency"].word
    if change == "one place":
        assert np.isnan(rows["speed against range rate scale error"].estimate.low)


def test_the_command_prints_json_and_writes_a_page(tmp_path: Path) -> None:
    columns = without_truth(synthetic_log(drawn_sensor(9), 9, 60.0, beams=2))
    path, page = written(tmp_path / "log.csv", columns, "columns"), tmp_path / "fit.html"
    done = CliRunner().invoke(cli, ["fit", str(path), "--json", "--html", str(page)], catch_exceptions=False)
    assert done.exit_code == 0
    document = json.loads(done.stdout)
    assert (document["shots"], document["beams"], document["reference"]) == (600, 2, "smoothed")
    assert all(
        check["inside"] == (check["low"] <= check["value"] <= check["high"]) for check in document["checks"]
    )
    text = page.read_text()
    assert text.count("<svg") == 2
    assert f"of {len(document['checks'])} figures of the held-out half are inside" in text
    assert not re.search(r"(src|href)=[\"']?http", text)


@pytest.mark.slow
def test_a_recording_is_read_as_a_table_of_the_same_flight(
    record: Callable[..., Recording], tmp_path: Path
) -> None:
    recording = record("descent", duration_s="30")
    table = tmp_path / "flight.csv"
    exported = CliRunner().invoke(cli, ["report", str(recording.path), "--out", str(table)])
    assert exported.exit_code == 0
    one, other = read_log(recording.path, {}), read_log(table, {})
    for name in ("range_m", "closing_speed_mps", "snr_db", "true_range_m"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), err_msg=name)
    # The detector's bins: 600 MHz of 131072 samples, at 2 THz/s and 1550 nm.
    bin_hz = 600e6 / 131072
    found = {row.what: row.estimate.value for row in characterised(one, 2.0).rows}
    assert found["range step"] == pytest.approx(299_792_458 / 2 / 2e12 * bin_hz, rel=1e-6)
    assert found["speed step"] == pytest.approx(1550e-9 / 2 * bin_hz, rel=1e-6)


@pytest.mark.skipif("LIDAR_EMU_REAL_DATA" not in os.environ, reason="LIDAR_EMU_REAL_DATA names no folder")
def test_a_real_flight_predicts_its_other_half() -> None:
    """New Shepard NS-13: steps, limits and noise as its readers found them, and held-out blocks inside the bands."""
    path = Path(os.environ["LIDAR_EMU_REAL_DATA"]) / NEW_SHEPARD
    log = read_log(path, NS13)
    fit = fit_log(log, 2.0)
    found = {(row.what, row.beam): row.estimate for row in fit.sensor.rows}
    assert found["range step", None].value == 1 / 16
    assert found["speed step", None].value == 1 / 256
    assert found["highest speed", None].value == pytest.approx(28.94, abs=0.01)
    assert found["lowest speed", None].value == pytest.approx(-45.61, abs=0.01)
    errors = fit.sensor.errors
    late = (log.time_s[:, 0] > 436.6) & (log.time_s[:, 0] < 447.1)
    speed_sigma_mps = [1.4826 * np.nanmedian(np.abs(errors.speed.residual[late, beam])) for beam in range(4)]
    assert speed_sigma_mps == pytest.approx([0.15, 0.11, 0.33, 0.12], rel=0.15)
    inside = {check.what: check.inside for check in fit.checks}
    for what in ("range", "speed"):
        for figure in ("area metric", "Kolmogorov-Smirnov distance", "share inside the 90 % band"):
            assert inside[f"{what} noise, {figure}"]
        assert min(each.noise.degrees.value for each in fit.sensor.noise_bins[what]) < 2.0
    share = {check.what: check.value for check in fit.checks}
    for what in ("range", "speed"):
        assert 0.85 <= share[f"{what} noise, share inside the 90 % band"] <= 0.95
