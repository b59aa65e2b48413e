"""Quantiles against numpy's, intervals against what repeated campaigns do."""

from __future__ import annotations

import numpy as np
import pytest

from lidar_emu.campaign.statistics import LEVELS, CampaignCounts, plot_columns, share, tally_beams

RUNS, BEAMS = 200, 100


def beams_of(rng, runs=RUNS, lost=0.1, spread=0.05, every=1):
    """A campaign whose runs differ in how much they lose and in a bias; all at 300 to 500 m, 12 degrees."""
    own_loss = np.clip(lost + spread * rng.standard_normal(runs), 0, 1)
    bias_m = 0.2 * rng.standard_normal(runs)
    valid = rng.random((runs, BEAMS)) >= own_loss[:, None]
    error_m = bias_m[:, None] + 0.3 * rng.standard_normal((runs, BEAMS))
    error_mps = 1e-3 * rng.standard_normal((runs, BEAMS))
    return {
        "run": np.repeat(every * np.arange(runs), BEAMS),
        "altitude_m": rng.uniform(300, 499, runs * BEAMS),
        "true_incidence_deg": np.full(runs * BEAMS, 12.0),
        "fired": np.ones(runs * BEAMS, dtype=bool),
        "range_valid": valid.ravel(),
        "true_range_m": np.full(runs * BEAMS, 400.0),
        "true_closing_speed_mps": np.full(runs * BEAMS, 20.0),
        "range_m": np.where(valid, 400.0 + error_m, np.nan).ravel(),
        "closing_speed_mps": np.where(valid, 20.0 + error_mps, np.nan).ravel(),
    }


def statistics(columns, every=1):
    """Statistics of runs that were flown in two batches, of which the last was done first."""
    counts, middle = CampaignCounts(), len(columns["run"]) // BEAMS // 2 * BEAMS
    for rows in (slice(middle, None), slice(middle)):
        counts.add([], tally_beams({name: column[rows] for name, column in columns.items()}, every))
    return counts.statistics()


def test_figures_are_those_of_all_beams_together():
    columns = beams_of(np.random.default_rng(1))
    altitude, incidence = statistics(columns)
    assert (altitude.axis, altitude.low, altitude.high) == ("altitude_m", 300.0, 500.0)
    assert (incidence.axis, incidence.low, incidence.high) == ("true_incidence_deg", 10.0, 15.0)
    errors = {
        "range_error_m": columns["range_m"] - 400.0,
        "speed_error_mps": columns["closing_speed_mps"] - 20.0,
    }
    for band in (altitude, incidence):
        assert (band.runs, band.expected) == (RUNS, RUNS * BEAMS)
        assert band.dropout.value == pytest.approx(1 - columns["range_valid"].mean(), rel=1e-12)
        for name, error in errors.items():
            for level, reported in zip(LEVELS, band.quantiles[name], strict=True):
                exact = np.nanquantile(error, level)
                assert reported.value == pytest.approx(exact, rel=0.01, abs=1e-2 * np.nanstd(error))
                assert reported.low < reported.value < reported.high


@pytest.mark.slow
def test_intervals_hold_what_they_promise():
    """Of 60 campaigns about 57 should have the truth within 95 %; 50 or fewer happen once in 3000 times."""
    rng = np.random.default_rng(2)
    held = {"dropout": 0, "median": 0, "tail": 0}
    half_m = []
    tail_m = 1.6448536 * np.hypot(0.2, 0.3)
    for _ in range(60):
        band = statistics(beams_of(rng))[0]
        middle, tail = band.quantiles["range_error_m"][1:]
        held["dropout"] += band.dropout.low <= 0.1007 <= band.dropout.high
        held["median"] += middle.low <= 0.0 <= middle.high
        held["tail"] += tail.low <= tail_m <= tail.high
        half_m.append((middle.high - middle.low) / 2)
    assert min(held.values()) > 50
    # Runs are biased as a whole: were beams independent, the intervals would be a fifth as wide. The share of a run's
    # errors below 0 has the variance arcsin(0.04/0.13)/2π, and that of drawing 100 of them.
    of_bias = np.arcsin(0.04 / 0.13) / (2 * np.pi)
    share_sigma = np.sqrt((of_bias + (0.25 - of_bias) / BEAMS) / RUNS)
    density_per_m = 1 / np.sqrt(2 * np.pi * 0.13)
    assert np.mean(half_m) == pytest.approx(2.0095752 * share_sigma / density_per_m, rel=0.05)


def test_intervals_are_the_same_of_whichever_runs_are_kept():
    by_every = [statistics(beams_of(np.random.default_rng(4), every=every), every) for every in (1, 50)]
    assert by_every[0] == by_every[1]


@pytest.mark.parametrize(("part", "value", "high"), [(0, 0.0, 0.0885), (1000, 1.0, 1.0)])
def test_none_and_all_are_not_certain(part, value, high):
    """Wilson's interval of 0 of 50 runs, with Student's factor of 49 degrees of freedom: t² / (n + t²)."""
    reported = share(np.full(50, part // 50), np.full(50, 20), 50)
    square = 2.0095752**2
    bound = square / (50 + square)
    assert reported.value == value
    assert (reported.low, reported.high) == pytest.approx(
        (0.0, bound) if part == 0 else (1 - bound, 1.0), abs=1e-6
    )
    assert high == pytest.approx(reported.high, abs=0.02)


def test_a_single_run_reports_no_interval():
    band = statistics(beams_of(np.random.default_rng(3), runs=1))[0]
    assert (band.dropout.low, band.dropout.high) == (0.0, 1.0)
    for reported in band.quantiles["range_error_m"]:
        assert np.isfinite(reported.value)
        assert np.isnan([reported.low, reported.high]).all()


def test_a_plot_leaves_out_bands_that_few_runs_reach_and_counts_the_others():
    columns = beams_of(np.random.default_rng(4), runs=100)
    columns["altitude_m"][: 4 * BEAMS] = 600.0
    columns["true_incidence_deg"][: 5 * BEAMS] = 40.0
    altitude, incidence = plot_columns(statistics(columns))
    assert altitude.middle.tolist() == [150000.0**0.5]
    assert altitude.counts == {"flights": [96], "beam shots": [96 * BEAMS]}
    assert incidence.middle.tolist() == [12.5, 42.5]


def test_nothing_kept_is_nothing_reported():
    assert CampaignCounts().statistics() == []
