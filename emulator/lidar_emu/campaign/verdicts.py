"""Verdicts on requirements over a campaign: pass, fail or not enough runs, at a stated confidence.

Runs are independent trials, each of which meets a requirement or misses it. A requirement passes if the lower
confidence bound of its probability (Clopper and Pearson 1934, one-sided) is at least the required one, fails if the
upper bound is below it, and is undecided otherwise. Counting misses is the same test as comparing the limit with the
confidence bound of a quantile by order statistics (Wilks 1941): the bound, an observed value, keeps the limit if, and
only if, the number of misses is allowed.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from lidar_emu.campaign.requirements import CampaignRequirement, Requirement, RunValues
from lidar_emu.numerics.binomial import exact_interval
from lidar_emu.scenario.campaign import Campaign

_MOST_RUNS = 2**62
"""More than any probability below 1 needs to be shown without a miss."""


class RequirementVerdict(StrEnum):
    """Verdict on a requirement."""

    PASS = "pass"
    FAIL = "fail"
    UNDECIDED = "not enough runs"


class Miss(NamedTuple):
    """A run that misses a requirement."""

    run: int
    seed: int
    value: float | None
    """None: the run failed, or measured nothing that the requirement judges."""


class Judgement(NamedTuple):
    """The verdict on a requirement, and what it rests on."""

    requirement: Requirement
    verdict: RequirementVerdict
    runs: int
    """Number of runs that judged it."""
    low: float
    """Lower confidence bound of the probability that a run meets it."""
    high: float
    """Upper confidence bound of that probability."""
    bound: float | None
    """Limit that would just pass, an observed value; None: no limit would."""
    missed: list[Miss]
    """Runs that miss it, the worst first."""

    def document(self) -> dict[str, Any]:
        """Its figures for JSON, without the list of runs."""
        figures = self._asdict() | {"missed": len(self.missed)}
        return {"id": figures.pop("requirement").id, **figures}


class RequirementPlan(NamedTuple):
    """The runs that a requirement needs, before any is flown."""

    id: str
    runs: int
    """Runs of the campaign that judge it."""
    least_runs: list[int]
    """Least runs that pass with no miss, one and two."""
    most_misses: int
    """Most misses with which the campaign passes; -1: it cannot pass."""
    failing_misses: int
    """Least misses with which it fails."""

    def __str__(self) -> str:
        none, one, two = self.least_runs
        needs = f"{self.id} needs {none} runs, {one} with a miss, {two} with two"
        fails = f"fails from {self.failing_misses} on"
        if self.most_misses < 0:
            return f"{needs}; {self.runs} runs cannot pass"
        return f"{needs}; of {self.runs} runs up to {self.most_misses} may miss, and it {fails}"


def plan_requirement(requirement: CampaignRequirement, campaign: Campaign) -> RequirementPlan:
    """Plan how many runs a requirement needs, and how many of the campaign's may miss it."""
    every = 1 if requirement.run is not None else campaign.beams_every
    runs = -(-campaign.runs // every)
    return RequirementPlan(
        requirement.id,
        runs,
        [least_runs(requirement, misses) for misses in range(3)],
        most_misses(requirement, runs),
        failing_misses(requirement, runs),
    )


def most_misses(requirement: Requirement, runs: int) -> int:
    """Most misses with which so many runs pass; -1: they cannot pass."""
    if requirement.probability is None:
        return 0
    doubt = 1 - requirement.confidence
    return bisect_right(range(runs + 1), doubt, key=lambda misses: _tail(requirement, misses, runs)) - 1


def failing_misses(requirement: Requirement, runs: int) -> int:
    """Least misses with which so many runs fail; `runs + 1`: they cannot fail."""
    if requirement.probability is None:
        return 1
    confidence = requirement.confidence
    return 1 + bisect_right(range(runs), confidence, key=lambda misses: _tail(requirement, misses, runs))


def least_runs(requirement: Requirement, misses: int) -> int:
    """Least number of runs that pass with so many misses; a campaign may have fewer."""
    runs, doubt = range(misses + 1, _MOST_RUNS + 1), 1 - requirement.confidence
    return runs.start + bisect_left(runs, -doubt, key=lambda count: -_tail(requirement, misses, count))


def _tail(requirement: Requirement, misses: int, runs: int) -> float:
    """Probability of so many misses or fewer, where a run meets the requirement just as often as it must."""
    from scipy.special import betainc  # bdtr is NaN from 2**31 runs on

    return float(betainc(runs - misses, misses + 1, requirement.probability))


def judge(requirement: Requirement, values: RunValues) -> Judgement:
    """Judge a requirement by the values of independent runs; a run without a value misses it."""
    runs, sign = len(values.run), requirement.sign
    # Smaller is better, and nothing is worse than no value.
    ordered = np.where(np.isfinite(values.value), sign * values.value, np.inf)
    worst_first = np.argsort(-ordered, kind="stable")
    missed = worst_first[ordered[worst_first] > sign * requirement.limit].tolist()
    allowed = most_misses(requirement, runs)
    if len(missed) <= allowed:
        verdict = RequirementVerdict.PASS
    elif len(missed) >= failing_misses(requirement, runs):
        verdict = RequirementVerdict.FAIL
    else:
        verdict = RequirementVerdict.UNDECIDED
    bound = sign * ordered[worst_first[allowed]] if allowed >= 0 else np.inf
    bounds = exact_interval(runs - len(missed), runs, 1 - requirement.confidence)
    return Judgement(
        requirement,
        verdict,
        runs,
        *bounds,
        _known(bound),
        [Miss(int(values.run[i]), int(values.seed[i]), _known(values.value[i])) for i in missed],
    )


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
