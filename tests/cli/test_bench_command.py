"""`lidar-emu bench accuracy`: complete for people, machines and the eye, on an instrument with short records."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest
from click.testing import CliRunner

from lidar_emu.bench.accuracy import AccuracyReport, measure_accuracy
from lidar_emu.bench.settings import REFERENCE
from lidar_emu.cli import cli
from lidar_emu.errors import RunError
from lidar_emu.scenario.load import load

SHORT = {
    "duration_s": "1.5",
    "instrument.waveform.fft_length": "4096",
    "instrument.optics.laser_power_w": "40",
}
BEAMLETS = [1, 7, 19, 37, 61, 127]


@pytest.fixture(scope="module")
def report():
    return measure_accuracy(load("descent.yaml", SHORT), 120, lambda _: None)


@pytest.fixture
def run(monkeypatch, request):
    def invoke(*arguments: str, reported: AccuracyReport | None = None):
        def measured(*_):
            return reported or request.getfixturevalue("report")

        monkeypatch.setattr("lidar_emu.bench.accuracy.measure_accuracy", measured)
        return CliRunner().invoke(cli, ["bench", "accuracy", *arguments], standalone_mode=False)

    return invoke


@pytest.fixture
def reported(run):
    done = run("--json", "--target-range-error", "1e3")
    assert done.exception is None, done.exception
    return json.loads(done.stdout)


@pytest.mark.slow
def test_every_level_and_dial_is_there(reported):
    found = {(row["level"], row["exact"], row["beamlets"]) for row in reported["settings"]}
    expected = {("geometric", True, 1), ("reference", True, 127)}
    for level, exact in (("spectral", False), ("spectral", True)):
        expected |= {(level, exact, beamlets) for beamlets in BEAMLETS}
    assert found == expected
    names = [row["name"] for row in reported["settings"]]
    assert len(names) == len(set(names)) == len(expected)
    assert reported["reference"] == names[-1]


@pytest.mark.slow
def test_figures_are_complete(reported):
    against_truth = {
        "range_bias_m",
        "range_rms_m",
        "speed_bias_mps",
        "speed_rms_mps",
        "dropout",
        "false_lock",
    }
    against_reference = {"range_error_m", "speed_error_mps", "outcome_error"}
    for row in reported["settings"]:
        assert row["time_s"] == pytest.approx(row["front_s"] + row["receiver_s"])
        assert row["time_s"] > 0
        assert math.isfinite(row["faster_than_reference"])
        assert all(math.isfinite(row[name]) for name in against_truth | against_reference)
    every_one_will_do = min(reported["settings"], key=lambda row: row["time_s"])
    assert reported["cheapest"] == every_one_will_do["name"]


@pytest.mark.slow
def test_the_reference_is_exact_and_geometric_is_what_it_leaves_out(reported):
    rows = {row["name"]: row for row in reported["settings"]}
    reference = rows[reported["reference"]]
    assert (reference["range_error_m"], reference["speed_error_mps"], reference["outcome_error"]) == (0, 0, 0)
    assert reference["pareto"]
    assert rows["geometric"]["range_rms_m"] == 0
    spectral = rows["spectral 127"]
    assert rows["geometric"]["range_error_m"] == pytest.approx(reference["range_rms_m"], rel=1e-3)
    # Range bins of 11 m: levels agree to the sampling noise of a few shots.
    assert spectral["range_error_m"] < 0.5 * spectral["range_rms_m"]


@pytest.mark.slow
def test_table_names_every_setting(run):
    done = run()
    assert done.exception is None, done.exception
    for name in ("geometric", *(f"spectral {n}" for n in BEAMLETS)):
        assert name in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert "…" not in done.stdout


@pytest.mark.slow
def test_picture(run, tmp_path):
    assert run("--plot", str(tmp_path / "accuracy.png")).exception is None
    assert (tmp_path / "accuracy.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("option", "of"), [("--target-range-error", "range_m"), ("--target-dropout", "outcome")]
)
def test_cheapest_for_a_target(run, report, option, of):
    """Geometric never drops a beam, which the echoes of this flight do."""
    rows = {result.setting.name: result for result in report.results}
    bound = 1.01 * report.resolved_error(rows["spectral 127"]).range_m
    if of == "outcome":
        bound = 0.99 * rows["geometric"].error.outcome
    able = [r for r in report.results if getattr(report.resolved_error(r), of) <= bound]
    wanted = min(able, key=lambda r: r.time_s).setting
    assert of == "range_m" or wanted.level != "geometric"
    lines = run(option, repr(bound)).stdout.splitlines()
    assert lines[-1].startswith(f"cheapest: {wanted.name},")
    assert f"--set level={wanted.level} --set instrument.optics.beamlets={wanted.beamlets}" in lines[-1]


@pytest.mark.slow
def test_a_target_that_nothing_meets_fails(run, report):
    without_reference = replace(report, results=report.results[:3])
    error = run("--target-range-error", "1e-9", reported=without_reference).exception
    assert isinstance(error, RunError)
    assert "no setting" in str(error)


@pytest.mark.slow
def test_no_setting_is_better_than_the_sampling_noise(report):
    for result in report.results:
        if result.error is None:
            assert math.isnan(report.resolved_error(result).range_m)
        elif result.setting == REFERENCE:
            assert report.resolved_error(result) == result.error
        else:
            assert report.resolved_error(result).range_m >= report.floor.range_m
