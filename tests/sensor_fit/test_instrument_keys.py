"""Keys of an instrument fitted to logs of known instruments."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.stats import binom

from benchmarks.key_coverage import known_problem
from lidar_emu.api import simulate
from lidar_emu.cli import cli
from lidar_emu.errors import InputError
from lidar_emu.scenario.load import load
from lidar_emu.scenario.parts import shipped
from lidar_emu.sensor_fit import instrument_keys
from lidar_emu.sensor_fit.instrument_keys import Flights, estimates_of, posterior_of


def test_intervals_hold_the_keys_of_a_sensor_whose_figures_have_a_known_law() -> None:
    """Figures that are sums of the keys with Gaussian noise, in place of flights; one key that no figure depends on."""
    problem = known_problem("descent", has_truth=True)
    keys, figures = len(problem.keys), 12
    rng = np.random.default_rng(1)
    mixing = rng.standard_normal((figures, keys))
    mixing[:, 0] = 0.0

    def flights(count: int) -> Flights:
        parts = rng.random((count, keys))
        noise = 0.2 * rng.standard_normal((count, figures))
        return Flights(parts, rng.integers(4, size=count), parts @ mixing.T + noise)

    flown, sensors = flights(1024), flights(150)
    held, tells = [], []
    for parts, found in zip(sensors.parts, sensors.figures, strict=True):
        estimates = estimates_of(problem, posterior_of(flown, found))
        true = [float(key.value(part)) for key, part in zip(problem.keys, parts, strict=True)]
        held += [
            each.estimate.low <= key <= each.estimate.high for each, key in zip(estimates, true, strict=True)
        ]
        tells.append([each.tells for each in estimates])
    trials = len(held) // 2
    assert binom.ppf(1e-4, trials, 0.9) <= np.mean(held) * trials <= binom.ppf(1 - 1e-4, trials, 0.9)
    share = np.mean(tells, axis=0)
    assert share[0] < 0.1
    assert (share[1:] > 0.9).all()


SCENARIO = """
name: flight
timing: {rate_hz: 10}
duration_s: 25
instrument: ndl_fine
site: flat
scanner: ndl_four_beam
trajectory:
  kind: profile
  waypoints:
    - {altitude_m: 1500, speed_mps: 60}
    - {altitude_m: 500, speed_mps: 10}
"""


@pytest.mark.slow
def test_an_instrument_is_fitted_to_a_log_and_flown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(instrument_keys, "FLIGHTS", 64)
    scenario, log, fitted = tmp_path / "flight.yaml", tmp_path / "log.csv", tmp_path / "fitted.yaml"
    scenario.write_text(SCENARIO)

    def power_w(true_w: float) -> tuple[float, float, float]:
        settings = ["--set", f"instrument.optics.laser_power_w={true_w}", "--seed", "5"]
        run("simulate", str(scenario), "--out", str(log), *settings)
        options = ["--scenario", str(scenario), "--instrument", str(fitted), "--seed", "2", "--json"]
        document = json.loads(run("fit", str(log), *options))
        found = {each["key"]: each for each in document["keys"]}["instrument.optics.laser_power_w"]
        assert found["tells"]
        # Values without steps are not of bins.
        assert "bin" not in document["peak"]
        return found["low"], found["value"], found["high"]

    dim, bright = power_w(0.1), power_w(3.0)
    # Losses by alignment are told from power only by range, so that the intervals overlap where both are wide.
    assert dim[2] < bright[1]
    assert dim[1] < bright[0]
    flown = load(scenario, {"instrument": str(fitted)})
    assert flown.instrument.name == "fitted"
    assert flown.instrument.optics.laser_power_w == pytest.approx(bright[1], rel=1e-3)
    assert flown.instrument.detection.combine == "least_squares"
    assert f"({bright[0]:.3g} to {bright[2]:.3g})" in fitted.read_text()


def run(*arguments: str) -> str:
    done = CliRunner().invoke(cli, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--instrument", "fitted.yaml"], "--instrument: needs --scenario"),
        (["--scenario", "descent"], "--scenario: needs --instrument"),
        (["--scenario", "descent", "--instrument", "fitted.txt"], "--instrument"),
        (["--scenario", "bench", "--instrument", "fitted.yaml"], "a bench pattern has no geometry"),
        (["--scenario", "geometric.yaml", "--instrument", "fitted.yaml"], "level: must be spectral"),
        (["--scenario", "live", "--instrument", "fitted.yaml"], "trajectory.kind"),
    ],
)
def test_options_that_do_not_fit_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    rows = [f"{k / 10},{500 - k},{10}" for k in range(200)]
    Path("log.csv").write_text("\n".join(["time_s,range_m,closing_speed_mps", *rows]) + "\n")
    text = (shipped("scenarios") / "descent.yaml").read_text()
    Path("geometric.yaml").write_text(f"{text}level: geometric\n")
    with pytest.raises(InputError) as refusal:
        CliRunner().invoke(cli, ["fit", "log.csv", *options], catch_exceptions=False)
    assert words in str(refusal.value)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["geometric.yaml", "log.csv"]


@pytest.mark.slow
def test_a_log_of_bins_gives_waveform_and_peak_method(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scenario states another sample rate and slope than those of the log's instrument."""
    monkeypatch.setattr(instrument_keys, "FLIGHTS", 32)
    scenario, log, fitted = tmp_path / "flight.yaml", tmp_path / "log.csv", tmp_path / "fitted.yaml"
    scenario.write_text(SCENARIO.replace("ndl_fine", "ndl_four_beam"))
    run("simulate", str(scenario), "--out", str(log), "--seed", "5")
    other = SCENARIO.replace(
        "ndl_fine",
        "{base: ndl_four_beam, waveform: {sample_rate_hz: 6.2e8, chirp_slope_hz_per_s: 2.1e12}}",
    )
    scenario.write_text(other)
    document = json.loads(
        run("fit", str(log), "--scenario", str(scenario), "--instrument", str(fitted), "--json")
    )
    assert document["peak"] == {"bin": pytest.approx(1.0)}
    found, true = (load(scenario, {"instrument": str(each)}).instrument for each in (fitted, "ndl_four_beam"))
    assert found.waveform.range_bin_m == pytest.approx(true.waveform.range_bin_m, rel=1e-4)
    assert found.waveform.speed_bin_mps == pytest.approx(true.waveform.speed_bin_mps, rel=1e-4)
    assert found.detection.peak == "bin"


def test_steps_that_are_bins_give_the_waveform() -> None:
    instrument = load("descent").instrument
    waveform = instrument.waveform
    changed = instrument_keys._bins_by_steps(
        instrument, (2 * waveform.range_bin_m, 3 * waveform.speed_bin_mps)
    )
    found = load("descent", {**changed, "instrument.detection.maximum_range_m": 5000}).instrument.waveform
    assert found.range_bin_m == pytest.approx(2 * waveform.range_bin_m)
    assert found.speed_bin_mps == pytest.approx(3 * waveform.speed_bin_mps)


def test_the_shipped_fit_is_as_noisy_as_its_flight_near_the_ground() -> None:
    """Robust sigma of New Shepard NS-13 in its last ten seconds, as its readers found it: 0.21 to 0.74 m by beam, and
    0.11 to 0.33 m/s; within a factor of 1.5."""
    flown = simulate("ns13_descent")
    low = flown.range_valid & (flown.truth.range_m < 60.0)
    errors = (
        (flown.range_m - flown.truth.range_m)[low],
        (flown.closing_speed_mps - flown.truth.closing_speed_mps)[low],
    )
    range_m, speed_mps = (1.4826 * float(np.median(np.abs(each))) for each in errors)
    assert 0.21 / 1.5 <= range_m <= 0.74 * 1.5
    assert 0.11 / 1.5 <= speed_mps <= 0.33 * 1.5
    assert low.sum() > 400
    # As on the flight, nearly all ranges of the descent are found.
    assert flown.range_valid.mean() > 0.95
