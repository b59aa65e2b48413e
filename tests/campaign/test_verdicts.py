"""Verdicts against scipy's exact interval, published numbers of runs, and campaigns whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import stats

from lidar_emu.campaign.description import draw
from lidar_emu.campaign.requirements import CampaignRequirement, RunValues, shot_values
from lidar_emu.campaign.verdicts import (
    RequirementVerdict,
    failing_misses,
    judge,
    least_runs,
    most_misses,
    plan_requirement,
)
from lidar_emu.scenario.campaign import Campaign

PASS, FAIL, UNDECIDED = RequirementVerdict
CAMPAIGNS = 2000


def requirement(probability=0.95, confidence=0.95, **keys) -> CampaignRequirement:
    stated = {"id": "R1", "text": "x", "run": "shots", "at_most": 0.0, **keys}
    return CampaignRequirement.model_validate(
        {**stated, "probability": probability, "confidence": confidence}
    )


def values_of(value) -> RunValues:
    value = np.asarray(value, dtype=np.float64)
    return RunValues(np.arange(value.size), 100 + np.arange(value.size), value)


def judged(runs, misses, probability=0.95, confidence=0.95):
    return judge(requirement(probability, confidence), values_of([1.0] * misses + [0.0] * (runs - misses)))


@pytest.mark.parametrize(
    ("probability", "confidence", "runs"),
    [
        (0.95, 0.95, [59, 93, 124]),  # Wilks 1941, and the tables of tolerance limits that follow from him
        (0.90, 0.90, [22, 38, 52]),
        (0.95, 0.99, [90, 130, 165]),
        (0.99, 0.95, [299, 473, 628]),
        (0.99, 0.99, [459, 662, 838]),
    ],
)
def test_numbers_of_runs_are_the_published_ones(probability, confidence, runs):
    assert [least_runs(requirement(probability, confidence), misses) for misses in range(3)] == runs


probabilities = st.floats(0.05, 0.999)
confidences = st.floats(0.5, 0.999)


@given(st.integers(1, 400), st.floats(0, 1), probabilities, confidences)
def test_bounds_and_verdict_are_those_of_the_exact_interval(runs, missed, probability, confidence):
    misses = round(missed * runs)
    found = judged(runs, misses, probability, confidence)
    exact = {
        side: stats.binomtest(runs - misses, runs, probability, side).proportion_ci(confidence)
        for side in ("greater", "less")
    }
    assert found.low == pytest.approx(exact["greater"].low, rel=1e-9, abs=1e-12)
    assert found.high == pytest.approx(exact["less"].high, rel=1e-9, abs=1e-12)
    assert len(found.missed) == misses
    if abs(found.low - probability) > 1e-9 and abs(found.high - probability) > 1e-9:
        assert (found.verdict is PASS) == (exact["greater"].low >= probability)
        assert (found.verdict is FAIL) == (exact["less"].high < probability)


@given(st.integers(1, 300), probabilities, confidences, st.integers(0, 2**32), st.booleans())
def test_a_limit_passes_if_it_keeps_the_bound_of_the_quantile(runs, probability, confidence, seed, at_most):
    """The bound by order statistics: the least rank that exceeds the quantile with the confidence."""
    value = np.random.default_rng(seed).normal(size=runs)
    side = "at_most" if at_most else "at_least"
    ranks = np.arange(1, runs + 1)
    reached = stats.binom.cdf(ranks - 1, runs, probability)
    assume(np.abs(reached - confidence).min() > 1e-9)  # rounding decides a tie
    enough = ranks[reached >= confidence]
    ordered = np.sort(value) if at_most else -np.sort(-value)
    for limit in (*value[:5], 0.0, -9.0, 9.0):
        stated = CampaignRequirement(
            id="R1", text="x", run="shots", probability=probability, confidence=confidence, **{side: limit}
        )
        found = judge(stated, values_of(value))
        bound = found.bound
        if not enough.size:
            assert bound is None
            assert found.verdict is not PASS
            continue
        assert bound == ordered[enough[0] - 1]
        assert (found.verdict is PASS) == (bound <= limit if at_most else bound >= limit)


@given(st.integers(1, 2000), probabilities, confidences)
def test_plans_say_what_verdicts_do(runs, probability, confidence):
    planned = requirement(probability, confidence)
    most, failing = most_misses(planned, runs), failing_misses(planned, runs)
    assert -1 <= most < failing <= runs + 1
    expected = {most: PASS, most + 1: UNDECIDED, failing - 1: UNDECIDED, failing: FAIL}
    if failing == most + 1:
        expected = {most: PASS, failing: FAIL}
    for misses, verdict in expected.items():
        if 0 <= misses <= runs:
            assert judged(runs, misses, probability, confidence).verdict is verdict
    if most >= 0:
        assert least_runs(planned, most) <= runs < least_runs(planned, most + 1)


def test_a_plan_counts_the_runs_that_judge():
    campaign = Campaign(name="c", scenario="descent.yaml", runs=100, beams_every=3)
    of_run = plan_requirement(requirement(), campaign)
    assert of_run == ("R1", 100, [59, 93, 124], 1, 10)
    assert str(of_run) == (
        "R1 needs 59 runs, 93 with a miss, 124 with two; of 100 runs up to 1 may miss, and it fails from 10 on"
    )
    of_shot = plan_requirement(requirement(run=None, shot="snr_db"), campaign)
    assert str(of_shot).endswith("; 34 runs cannot pass")
    rare = plan_requirement(requirement(1 - 1e-9), campaign)
    assert rare.least_runs[0] == pytest.approx(np.log(20) * 1e9, rel=1e-6)
    assert least_runs(requirement(np.nextafter(1, 0), np.nextafter(1, 0)), 0) < 2**62


def test_runs_without_a_value_miss_and_the_worst_are_first():
    found = judge(requirement(at_most=2.0), values_of([3, np.nan, 1, 5, 2]))
    assert [(miss.run, miss.seed, miss.value) for miss in found.missed] == [
        (1, 101, None),
        (3, 103, 5.0),
        (0, 100, 3.0),
    ]
    found = judge(requirement(at_most=None, at_least=2.0), values_of([3, np.nan, 1, 5, 2]))
    assert [miss.run for miss in found.missed] == [1, 2]


def test_no_limit_passes_where_too_many_runs_have_no_value():
    found = judge(requirement(), values_of([0.0] * 98 + [np.nan] * 2))
    assert found.bound is None
    assert judge(requirement(), values_of([0.0] * 99 + [np.nan])).bound == 0.0


def passes(verdicts) -> float:
    return sum(one is PASS for one in verdicts) / CAMPAIGNS


@pytest.mark.slow
@pytest.mark.parametrize("runs", [59, 100, 400])
def test_at_most_one_campaign_in_twenty_passes_wrongly(runs):
    """Runs whose normal value keeps the limit with 0.9499, just less than the 0.95 required, which is the worst case;
    and how often so many runs may pass, by the binomial distribution."""
    truth = 0.9499
    limit = stats.norm(3.0, 2.0).ppf(truth)
    value = np.random.default_rng(runs).normal(3.0, 2.0, (CAMPAIGNS, runs))
    stated = requirement(at_most=limit)
    found = passes(judge(stated, values_of(one)).verdict for one in value)
    exact = stats.binom.cdf(most_misses(stated, runs), runs, 1 - truth)
    assert found <= 0.06
    assert found == pytest.approx(exact, abs=4 * np.sqrt(exact / CAMPAIGNS))


@pytest.mark.slow
def test_at_most_one_campaign_in_twenty_fails_wrongly():
    truth, runs = 0.9501, 400
    value = np.random.default_rng(9).random((CAMPAIGNS, runs))
    verdicts = [judge(requirement(at_most=truth), values_of(one)).verdict for one in value]
    assert 0.02 < sum(one is FAIL for one in verdicts) / CAMPAIGNS <= 0.06


@pytest.mark.slow
def test_a_clear_truth_is_found():
    value = np.random.default_rng(8).random((CAMPAIGNS, 400))
    assert passes(judge(requirement(at_most=0.99), values_of(one)).verdict for one in value) > 0.98
    verdicts = [judge(requirement(at_most=0.88), values_of(one)).verdict for one in value]
    assert sum(one is FAIL for one in verdicts) / CAMPAIGNS > 0.98


@pytest.mark.slow
def test_beams_of_a_run_share_its_bias():
    """The probability that 36 of 40 beams keep the limit, by quadrature over the bias of a run. Were the same beams
    judged as independent trials, more than a quarter of the campaigns would pass wrongly."""
    runs, beams, bias_m, noise_m, limit_m = 100, 40, 0.3, 0.1, 0.6
    nodes, weights = np.polynomial.hermite_e.hermegauss(200)
    weights = weights / weights.sum()
    kept = stats.norm.cdf(limit_m, bias_m * nodes, noise_m) - stats.norm.cdf(
        -limit_m, bias_m * nodes, noise_m
    )
    truth = float(weights @ stats.binom.sf(35, beams, kept))
    stated = requirement(truth + 5e-4, run=None, shot="range_error_m_abs", at_most=limit_m, share=0.9)
    by_beam = float(weights @ kept)
    independent = requirement(by_beam + 5e-4)
    rng = np.random.default_rng(3)
    run = np.repeat(np.arange(runs), beams)
    full = np.ones(run.size, dtype=bool)
    verdicts, wrongly = [], 0
    for _ in range(CAMPAIGNS):
        error_m = bias_m * rng.standard_normal(runs)[run] + noise_m * rng.standard_normal(run.size)
        columns = {
            "run": run,
            "fired": full,
            "true_range_m": np.full(run.size, 64.0),
            "range_m": 64.0 + error_m,
        }
        value = shot_values(stated, columns, np.arange(runs))
        verdicts.append(judge(stated, values_of(value)).verdict)
        wrongly += int((np.abs(error_m) > limit_m).sum()) <= most_misses(independent, run.size)
    assert 0.02 < passes(verdicts) <= 0.06
    assert wrongly / CAMPAIGNS > 0.25


@pytest.mark.slow
@pytest.mark.parametrize("sampling", ["random", "latin_hypercube", "sobol"])
def test_campaigns_that_are_drawn_pass_wrongly_at_most_as_often(sampling):
    """A run's value is the sum of four normal dispersions, drawn as campaigns draw them."""
    keys = [f"key{i}" for i in range(4)]
    normal = {"kind": "normal", "mean": 1.0, "sigma": 0.5}
    stated = {
        "name": "c",
        "scenario": "s",
        "runs": 128,
        "sampling": sampling,
        "dispersions": dict.fromkeys(keys, normal),
    }
    judged_by = requirement(at_most=stats.norm(4.0, 1.0).ppf(0.9499))
    verdicts = []
    for seed in range(CAMPAIGNS):
        drawn = draw(Campaign.model_validate({**stated, "seed": seed}), "c.yaml")
        verdicts.append(
            judge(judged_by, values_of(np.sum([drawn.columns[key] for key in keys], axis=0))).verdict
        )
    assert passes(verdicts) <= 0.06
