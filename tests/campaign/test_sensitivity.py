"""Sobol indices of campaigns against closed forms, and what is refused."""

from __future__ import annotations

import csv
import importlib.util
import json
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from pyarrow import parquet
from scipy import stats
from small_campaign import ROWS, SMALL, Here

from lidar_emu import InputError, run_campaign, simulate
from lidar_emu.campaign.description import prepare
from lidar_emu.campaign.run import fly_campaign
from lidar_emu.campaign.sensitivity import factor_label, sensitivity_indices
from lidar_emu.cli.campaign import campaign as command

RANGE, SPEED = "range_error_m_abs_p50", "speed_error_mps_abs_p95"
ANGLES = ("mounting.roll_deg", "mounting.pitch_deg", "mounting.yaw_deg")
TURN = {"kind": "uniform", "low": -np.pi, "high": np.pi}


@pytest.fixture
def evaluate(tmp_path, monkeypatch):
    """Indices of a campaign whose runs are not flown: their errors of range and speed are functions of their values."""

    def evaluated(runs, range_error_m, speed_error_mps=lambda _: 1.0, altitude_m=lambda _: 2000.0, **keys):
        flown = simulate("descent.yaml", site="flat", duration_s=0.05)
        up = np.array([0.0, 0.0, 1.0])
        true = {"true_range_m": np.full((1, 4), 900.0), "true_closing_speed_mps": np.full((1, 4), 50.0)}

        def measured(_base, values):
            reported = {
                "range_m": true["true_range_m"] + range_error_m(values),
                "closing_speed_mps": true["true_closing_speed_mps"] + speed_error_mps(values),
                "range_valid": np.full((1, 4), True),
                "position_site_m": altitude_m(values) * up[None],
            }
            return replace(flown, **true, **reported)

        monkeypatch.setattr("lidar_emu.campaign.batch.measure_run", measured)
        stated = {"name": "x", "scenario": "descent.yaml", "runs": runs, "seed": 5, "sampling": "saltelli"}
        prepared = prepare(stated | keys, [], None)
        folder = tmp_path / "out"
        fly_campaign(prepared, ROWS, folder, Here(), lambda _: None)
        return sensitivity_indices(folder, prepared.campaign)

    return evaluated


def by_factor(indices, output, low_m=None):
    """The indices of an output: of the whole flight, or of the band from an altitude."""
    return {
        one.factor: one
        for one in indices
        if one.output == output and (one.low_m == low_m if low_m is not None else np.isnan(one.low_m))
    }


def assert_within_intervals(indices, expected, widest):
    """Expected: first and total index of each factor."""
    assert indices.keys() == expected.keys()
    for factor, shares in expected.items():
        for share, found in zip(shares, (indices[factor].first, indices[factor].total), strict=True):
            # Indices of 0 and 1 may be exact, with an interval of rounding errors.
            assert found.low - 1e-9 <= share <= found.high + 1e-9, (factor, share, found)
            assert found.high - found.low < widest, (factor, found)


@pytest.mark.slow
def test_ishigami(evaluate):
    """f = sin x + a sin² y + b z⁴ sin x (Ishigami and Homma 1990), whose z acts by interaction alone."""
    a, b = 7.0, 0.1

    def ishigami(values):
        x, y, z = (values[name] for name in ANGLES)
        return 20.0 + np.sin(x) + a * np.sin(y) ** 2 + b * z**4 * np.sin(x)

    indices = evaluate(512 * 6, ishigami, dispersions=dict.fromkeys(ANGLES, TURN))
    x = (1 + b * np.pi**4 / 5) ** 2 / 2
    y, together = a**2 / 8, b**2 * np.pi**8 * 8 / 225
    whole = x + y + together
    shares = ((x, x + together), (y, y), (0.0, together), (0.0, 0.0))
    expected = {
        name: tuple(share / whole for share in its)
        for name, its in zip((*ANGLES, "seed"), shares, strict=True)
    }
    for found in (by_factor(indices, RANGE), by_factor(indices, RANGE, 2000.0)):
        assert_within_intervals(found, expected, 0.4)
        assert {one.samples for one in found.values()} == {512}
        assert found["seed"].sigma == pytest.approx(np.sqrt(whole), rel=0.03)
    assert all(np.isnan(one.total.value) for one in by_factor(indices, "dropout").values())


@pytest.mark.slow
def test_a_linear_model_with_every_distribution_joint_keys_and_noise(evaluate):
    bounded = {"kind": "normal", "mean": 2000.0, "sigma": 40.0, "low": 1950.0, "high": 2100.0}
    height, power = "trajectory.waypoints.0.altitude_m", "instrument.optics.laser_power_w"
    reflectance, unit = "site.surface.reflectance", "wire.unit"
    dispersions = {
        height: bounded,
        power: {"kind": "lognormal", "median": 1.0, "sigma_log": 0.3},
        reflectance: {"kind": "triangular", "low": 0.1, "mode": 0.2, "high": 0.9},
        unit: {"kind": "integer", "low": 0, "high": 9},
    }
    covariance = [[0.04, 0.015], [0.015, 0.01]]
    joint = {"keys": list(ANGLES[:2]), "mean": [0.0, 0.0], "covariance": covariance}
    factor = {height: 0.02, power: 3.0, reflectance: 4.0, unit: 0.3, ANGLES[0]: 5.0, ANGLES[1]: -3.0}
    noise = 0.6

    def linear(values):
        scatter = np.random.default_rng(values["seed"]).normal()
        return sum(weight * values[name] for name, weight in factor.items()) + noise * scatter

    indices = evaluate(256 * 8, lambda _: 1.0, linear, dispersions=dispersions, joint_normals=[joint])
    roll, pitch = factor[ANGLES[0]], factor[ANGLES[1]]
    variance = {
        height: factor[height] ** 2 * stats.truncnorm(-1.25, 2.5, scale=40.0).var(),
        power: factor[power] ** 2 * stats.lognorm(0.3).var(),
        reflectance: factor[reflectance] ** 2 * stats.triang(0.125, 0.1, 0.8).var(),
        unit: factor[unit] ** 2 * (10**2 - 1) / 12,
        "seed": noise**2,
        " + ".join(ANGLES[:2]): np.array([roll, pitch]) @ np.array(covariance) @ np.array([roll, pitch]),
    }
    whole = sum(variance.values())
    expected = {name: (its / whole, its / whole) for name, its in variance.items()}
    assert min(share for share, _ in expected.values()) > 0.03
    assert_within_intervals(by_factor(indices, SPEED), expected, 0.35)


def test_a_run_differs_from_its_sample_in_one_factor():
    """Saltelli's design, by its definition: A, A with each factor of B, B."""
    power = "instrument.optics.laser_power_w"
    tree = {
        "name": "x", "scenario": "descent.yaml", "runs": 200, "sampling": "saltelli",
        "dispersions": {power: {"kind": "lognormal", "median": 1, "sigma_log": 0.1}},
        "joint_normals": [{"keys": list(ANGLES[:2]), "mean": [0, 0], "covariance": [[1, 0.5], [0.5, 1]]}],
    }  # fmt: skip
    prepared = prepare(tree, [], None)
    assert prepared.campaign.runs == 32 * 5
    values = [prepared.drawn.values(run) for run in range(160)]
    for sample in range(0, 160, 5):
        a, *changed, b = values[sample : sample + 5]
        assert all(a[key] != b[key] for key in a)
        for run, keys in zip(changed, ({power}, {"seed"}, {*ANGLES[:2]}), strict=True):
            assert run == {key: b[key] if key in keys else a[key] for key in a}
    for key in values[0]:
        assert len({each[key] for each in values}) == 64


def test_a_seed_that_is_set_is_that_of_all_runs(campaign_file):
    text = SMALL.replace("duration_s: 0.4", "duration_s: 0.4, seed: 7")
    for sensitivity, runs in ((False, 12), (True, 16 * 6)):
        prepared = prepare(campaign_file(text, runs), [], None, sensitivity)
        assert {prepared.drawn.values(run)["seed"] for run in range(runs)} == {7}
        assert "seed" not in prepared.campaign.drawn_keys


STRONG = """\
name: strong
scenario: descent.yaml
set: {{site: flat, duration_s: 0.4, instrument.optics.beamlets: 1, trajectory.waypoints.0.altitude_m: 800}}
runs: {runs}
seed: 5
dispersions:
  instrument.optics.laser_power_w: {{kind: lognormal, median: 20, sigma_log: 0.3}}
  site.surface.reflectance: {{kind: lognormal, median: 0.2, sigma_log: 0.15}}
  wire.unit: {{kind: integer, low: 0, high: 15}}
"""


def run(*arguments):
    return CliRunner().invoke(command, [str(argument) for argument in arguments])


@pytest.mark.slow
def test_a_flown_campaign(campaign_file, tmp_path):
    """Decibels are linear in the logarithms of power and reflectance, of which the number of photons is a product."""
    file, out, plot = campaign_file(STRONG, 500), tmp_path / "out", tmp_path / "plot.png"
    options = ["--out", out, "--workers", 1, "--sensitivity", "--column", "snr_db", "--column", "shots"]
    done = run(file, *options, "--plot", plot, "--json")
    assert done.exit_code == 0, done.output
    reported = json.loads(done.stdout)
    assert (reported["runs"], reported["failed"]) == (64 * 6, 0)
    assert plot.read_bytes().startswith(b"\x89PNG")
    with (out / "sensitivity.csv").open() as file_of_rows:
        written = list(csv.DictReader(file_of_rows))
    for row, cells in zip(reported["sensitivity"], written, strict=True):
        assert {name: "" if value is None else str(value) for name, value in row.items()} == cells
    rows = {
        row["factor"]: row
        for row in reported["sensitivity"]
        if row["output"] == "snr_db" and row["low_m"] is None
    }
    for factor, sigma_log in (("instrument.optics.laser_power_w", 0.3), ("site.surface.reflectance", 0.15)):
        share = (10 / np.log(10) * sigma_log / rows[factor]["sigma"]) ** 2
        assert rows[factor]["first_low"] < share < rows[factor]["first_high"]
        assert rows[factor]["total_low"] < share < rows[factor]["total_high"]
    assert rows["wire.unit"]["total"] == 0.0
    assert sum(row["total"] for row in rows.values()) == pytest.approx(1.0, abs=0.15)
    shots = [row for row in reported["sensitivity"] if row["output"] == "shots"]
    assert {(row["samples"], row["sigma"], row["first"]) for row in shots} == {(64, 0.0, None)}
    lines = run(file, *options).output.splitlines()
    assert "shots: no indices: sigma 0 in 64 samples" in lines
    assert lines[-1] == f"{out}: 384 runs, 0 failed"


@pytest.mark.slow
def test_outputs_are_those_of_the_tables(campaign_file, tmp_path):
    """Their standard deviations, over the first and the last run of each sample, against loops over rows."""
    text = SMALL.replace("low: 800", "low: 800, high: 990").replace(
        "low: 0.1, high: 0.3", "low: 0.005, high: 0.1"
    )
    file = campaign_file(text + "sampling: saltelli\n", 16 * 7)
    results = run_campaign(file, tmp_path / "out", workers=1)
    rows = defaultdict(list)
    for row in parquet.read_table(tmp_path / "out" / "beams").to_pylist():
        if row["fired"] and row["true_range_m"] is not None:
            rows[row["run"]].append(row)
    indices = results.sensitivity(["snr_db", "range_valid"])
    for output, of_run in (
        ("dropout", lambda of: np.mean([not row["range_valid"] for row in of])),
        ("range_valid", lambda of: np.mean([row["range_valid"] for row in of])),
        ("range_error_m_abs_p95", quantile_of_errors(0.95, "range_m")),
        ("speed_error_mps_abs_p50", quantile_of_errors(0.5, "closing_speed_mps")),
        ("snr_db", lambda of: np.mean([row["snr_db"] for row in of if row["snr_db"] is not None] or np.nan)),
    ):
        values = np.array([of_run(rows[run]) for run in range(16 * 7)]).reshape(16, 7)
        values = values[np.isfinite(values).all(axis=1)]
        assert len(values) >= 8
        for found in (by_factor(indices, output), by_factor(indices, output, 700.0)):
            assert {one.samples for one in found.values()} == {len(values)}
            # Errors of the whole flight are those before their columns are rounded.
            sigma = pytest.approx(np.std(values[:, [0, -1]]), rel=1e-3)
            assert all(one.sigma == sigma for one in found.values()), output


def quantile_of_errors(level, name):
    def of_run(of):
        errors = [abs(row[name] - row[f"true_{name}"]) for row in of if row[name] is not None]
        return np.quantile(errors, level) if errors else np.nan

    return of_run


def test_samples_with_a_failed_run_are_left_out(evaluate):
    def failing(values):
        if values[ANGLES[0]] > 3.0:
            raise InputError("x", None, values, "must be lower")
        return 1.0 + values[ANGLES[1]] ** 2

    keys = dict.fromkeys(ANGLES[:2], TURN)
    drawn = prepare(
        {
            "name": "x",
            "scenario": "descent.yaml",
            "runs": 160,
            "seed": 5,
            "sampling": "saltelli",
            "dispersions": keys,
        },
        [],
        None,
    ).drawn.columns[ANGLES[0]]
    whole = sum(max(drawn[first : first + 5]) <= 3.0 for first in range(0, 160, 5))
    assert 16 <= whole < 32
    found = by_factor(evaluate(160, failing, dispersions=keys), RANGE)
    assert {one.samples for one in found.values()} == {whole}
    assert found[ANGLES[1]].first.value > 0.5


def test_bands_that_few_samples_reach_have_no_indices(evaluate):
    """Every second run is at 2000 m, the others are at 100 m: no sample is whole."""
    keys = dict.fromkeys(ANGLES[:2], TURN)
    height = {"altitude_m": lambda values: 2000.0 if values[ANGLES[0]] > 0 else 100.0}
    indices = evaluate(160, lambda values: values[ANGLES[1]] ** 2, **height, dispersions=keys)
    for low_m in (100.0, 2000.0):
        assert all(one.samples < 16 for one in by_factor(indices, RANGE, low_m).values())
        assert all(np.isnan(one.total.value) for one in by_factor(indices, RANGE, low_m).values())
    assert by_factor(indices, RANGE)[ANGLES[1]].total.value > 0.9


ONE_KEY = SMALL[: SMALL.index("  trajectory")]


@pytest.mark.parametrize(
    ("text", "options", "reported"),
    [
        (SMALL, ["--runs", "111"], "runs: must be at least 112 for 5 sources of scatter (got 111)"),
        (ONE_KEY, ["--set", "seed=1"], "dispersions: a single source of scatter; draw two keys or more"),
        (SMALL, ["--column", "snr"], "--column: snr: no such column; did you mean snr_db? name a column of"),
        (SMALL + "beams_every: 2\n", ["--column", "snr_db"], "--column: snr_db: not stored for every run"),
    ],
)
def test_what_has_no_indices_is_refused(campaign_file, tmp_path, text, options, reported):
    done = run(campaign_file(text, 112), "--out", tmp_path / "out", "--sensitivity", *options)
    assert isinstance(done.exception, InputError), done.exception
    assert reported in str(done.exception)
    assert not (tmp_path / "out").exists()


def test_a_column_without_indices_is_refused(campaign_file, tmp_path):
    done = run(campaign_file(), "--out", tmp_path / "out", "--column", "snr_db")
    assert str(done.exception) == "--column: without --sensitivity; pass both"


@pytest.mark.parametrize(
    ("factor", "label"),
    [
        ("seed", "noise (seed)"),
        (" + ".join(ANGLES[:2]), "roll (°) + pitch (°) of mounting"),
        ("timing.rate_hz + site.surface.reflectance", "rate (Hz) of timing + reflectance of site.surface"),
        ("wire.unit", "unit of wire"),
    ],
)
def test_a_plot_names_quantity_and_unit_of_a_key(factor, label):
    assert factor_label(factor) == label


def test_a_missing_library_is_named(campaign_file, tmp_path, monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr("lidar_emu.files.find_spec", lambda name: None if name == "SALib" else found(name))
    done = run(campaign_file(SMALL, 112), "--out", tmp_path / "out", "--sensitivity")
    assert isinstance(done.exception, InputError)
    assert "a sensitivity analysis requires SALib; run: " in str(done.exception)


def test_another_campaign_has_no_indices(campaign_file, tmp_path):
    results = run_campaign(campaign_file(SMALL, 1), tmp_path / "out", workers=1)
    with pytest.raises(InputError, match=r"^sensitivity: sampling: must be 'saltelli' \(got 'random'\)"):
        results.sensitivity()
