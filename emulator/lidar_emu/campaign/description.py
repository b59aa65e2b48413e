"""The file of a campaign, the values that are drawn for its runs, and their scenarios."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.files import check_extra
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.random_streams import RUN_SEEDS, SHARES, generator
from lidar_emu.scenario.campaign import (
    Campaign,
    Choice,
    Distribution,
    Integer,
    JointNormal,
    Lognormal,
    Normal,
    Triangular,
    Uniform,
)
from lidar_emu.scenario.explain import Source, validated
from lidar_emu.scenario.load import (
    find_file,
    find_file_or_pipe,
    flown_otherwise,
    read_scenario,
    require_flight,
    require_known_flight,
)
from lidar_emu.scenario.parts import CAMPAIGN, PART_FOLDERS, ChangedKey, plain_mapping
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scenario.yaml_text import Key, read_mapping

_FIRST_RUNS = 16
_IN_PYTHON = Path("campaign")


@dataclass(frozen=True)
class Base:
    """The part of the scenario that all runs share, small enough to be sent to each worker."""

    scenario: str
    """Path of the scenario."""
    fixed: dict[str, Any]
    """Values of all runs by dotted key."""

    def scenario_of(self, values: Mapping[str, Any]) -> FlightScenario:
        """Build the scenario of a run with these values.

        Raises:
            InputError: a value cannot be used, or the scenario is not a flight, or a flight with live truth.
        """
        changes = [ChangedKey(key, deepcopy(value), CAMPAIGN) for key, value in self.stated(values)]
        return require_flight(require_known_flight(read_scenario(Path(self.scenario), changes)))

    def stated(self, values: Mapping[str, Any]) -> list[tuple[str, Any]]:
        """All keys of a run with these values, in the order in which they are set."""
        # Parents first, so that keys can be set within a part that is chosen by name.
        return sorted({**self.fixed, **values}.items(), key=lambda item: item[0].count("."))


@dataclass(frozen=True)
class PreparedCampaign:
    """A campaign with its drawn values, ready to be flown."""

    campaign: Campaign
    base: Base
    drawn: DrawnValues
    first: FlightScenario
    """Scenario of the first valid run."""


def read_campaign(
    stated: Path | Mapping[str, Any], runs: int | None = None, sensitivity: bool = False
) -> tuple[Path, Campaign]:
    """Read and check a campaign, and return its source as well: the path of its file, or `campaign` for a mapping.

    Args:
        stated: path of its file, the name of a shipped campaign, or a mapping with the keys of a file.
        runs: number of runs from `--runs`; None: as in the file.
        sensitivity: sample for Sobol indices, whatever the file's sampling.

    Raises:
        InputError: names the file, the key, the value that cannot be used, and what can.
    """
    if isinstance(stated, Mapping):
        found = _IN_PYTHON
        tree = plain_mapping(stated, str(found))
    else:
        found = find_file_or_pipe(stated, "campaigns")
        tree = read_mapping(found)
    if "scenario" not in tree and tree.keys() & PART_FOLDERS.keys():
        raise flown_otherwise(str(found), "scenarios")
    sources: dict[Key, Source] = {(): Source(str(found))}
    if runs is not None:
        tree["runs"] = runs
        sources["runs",] = Source("--runs", outer=1)
    if sensitivity:
        tree["sampling"] = "saltelli"
    return found, validated(Campaign, tree, sources)


def prepare(
    stated: Path | Mapping[str, Any],
    changes: Sequence[ChangedKey],
    runs: int | None,
    sensitivity: bool = False,
) -> PreparedCampaign:
    """Read a campaign and draw its values.

    Args:
        stated: path of its file, the name of a shipped campaign, or a mapping with the keys of a file. A scenario
            that a mapping names is relative to the working directory.
        changes: keys that all runs have instead of the campaign's and the scenario's.
        runs: number of runs; None: as in the file.
        sensitivity: sample for Sobol indices, whatever the file's sampling.

    Raises:
        InputError: the campaign or its scenario cannot be used, the first runs are all invalid, or SALib is needed and
            not installed.
    """
    found, campaign = read_campaign(stated, runs, sensitivity)
    for change in changes:
        if change.key in campaign.drawn_keys:
            remedy = f"set keys that {found} does not draw"
            raise InputError(change.stated_by, change.key, Finding("drawn"), remedy)
    beside = found.parent / campaign.scenario
    scenario = find_file(beside if beside.is_file() else Path(campaign.scenario), "scenarios")
    fixed = campaign.set | {change.key: change.value for change in changes}
    base = Base(str(scenario.resolve()), fixed)
    if campaign.sampling == "saltelli":
        check_extra(str(found), "a sensitivity analysis", "SALib", "sensitivity")
        campaign = _whole_design(campaign, "seed" in fixed, str(found))
    drawn = draw(campaign, str(found))
    if "seed" in fixed:
        drawn = drawn._replace(seeds=[fixed["seed"]] * campaign.runs)
    return PreparedCampaign(campaign, base, drawn, _first_flown(base, drawn, campaign.runs))


def _first_flown(base: Base, drawn: DrawnValues, runs: int) -> FlightScenario:
    """Find the first valid run: a single invalid draw is a failed run, but an invalid key fails every run.

    Raises:
        InputError: the first runs are all invalid.
    """
    refusal: InputError | None = None
    for run in range(min(runs, _FIRST_RUNS)):
        try:
            return base.scenario_of(drawn.values(run))
        except InputError as error:
            refusal = refusal or error
    assert refusal is not None
    raise refusal


LEAST_SAMPLES = 16
"""Samples below which the bootstrap of an index means nothing."""
_ANY_SEED = Integer(kind="integer", low=0, high=2**52)


def sensitivity_problem(campaign: Campaign) -> dict[str, Any]:
    """The campaign's probabilities as SALib describes a problem."""
    keys = campaign.factors
    return {
        "num_vars": len(keys),
        "names": list(keys),
        "groups": list(keys.values()),
        "bounds": [[0.0, 1.0]] * len(keys),
    }


def _whole_design(campaign: Campaign, seed_is_fixed: bool, path: str) -> Campaign:
    """The campaign with the seed of its runs among the drawn keys, unless it is fixed, and with as many of its runs as
    make a whole design: a power of two of samples, each of a run per factor and two more."""
    if not seed_is_fixed and "seed" not in campaign.drawn_keys:
        drawn = {**campaign.dispersions, "seed": _ANY_SEED}
        campaign = campaign.model_copy(update={"dispersions": drawn})
    count = len(campaign.factor_names)
    if count < 2:
        raise InputError(path, "dispersions", Finding("a single source of scatter"), "draw two keys or more")
    samples = campaign.runs // (count + 2)
    if samples < LEAST_SAMPLES:
        least = LEAST_SAMPLES * (count + 2)
        raise InputError(
            path, "runs", campaign.runs, f"must be at least {least} for {count} sources of scatter"
        )
    whole = (count + 2) << (samples.bit_length() - 1)
    return campaign.model_copy(update={"runs": whole})


_NEAREST_END = 2.0**-32
"""Distance of probabilities from 0 and 1, where normal quantiles are infinite: 6.2 sigma, and below Sobol's step."""


class DrawnValues(NamedTuple):
    """The values in which the runs differ."""

    columns: dict[str, list[Any]]
    """A value per run, by dotted key."""
    seeds: list[int]
    """Seed of each run, unless the key `seed` is drawn."""

    def values(self, run: int) -> dict[str, Any]:
        """Values of one run by dotted key."""
        return {"seed": self.seeds[run]} | {key: column[run] for key, column in self.columns.items()}


def draw(campaign: Campaign, path: str) -> DrawnValues:
    """Draw all values of all runs, from the campaign alone.

    Args:
        campaign: the campaign.
        path: path of its file, for error messages.

    Raises:
        InputError: a matrix is not positive definite.
    """
    distributions = _distributions(campaign)
    probability = _sample(campaign, len(distributions))
    indices = {key: i for i, key in enumerate(distributions)}
    for keys, lower in _triangles(campaign, path):
        rows = [indices[key] for key in keys]
        probability[rows] = _correlated(probability[rows], lower)
    columns = {
        key: _values_at(distribution, np.clip(probability[i], _NEAREST_END, 1 - _NEAREST_END))
        for i, (key, distribution) in enumerate(distributions.items())
    }
    seeds = generator(campaign.seed, RUN_SEEDS).integers(0, 2**63, size=campaign.runs, dtype=np.int64)
    return DrawnValues(columns, [int(seed) for seed in seeds])


def _distributions(campaign: Campaign) -> dict[str, Distribution]:
    """Distribution of every drawn key; a joint normal contributes its marginal distributions."""
    margins = {
        key: Normal(kind="normal", mean=mean, sigma=sigma)
        for joint in campaign.joint_normals
        for key, mean, sigma in zip(joint.keys, joint.mean, _sigmas(joint), strict=True)
    }
    return {**campaign.dispersions, **margins}


def _sigmas(joint: JointNormal) -> list[float]:
    return [max(row[i], 0.0) ** 0.5 or 1.0 for i, row in enumerate(joint.covariance)]


def _sample(campaign: Campaign, count: int) -> FloatArray:
    """(count, runs) Independent uniform samples from 0 to 1."""
    stream = generator(campaign.seed, SHARES)
    if count == 0:
        return np.empty((0, campaign.runs))
    if campaign.sampling == "random":
        # Run by run, so that a campaign with more runs begins with the same runs.
        return stream.random((campaign.runs, count)).T.copy()
    if campaign.sampling == "latin_hypercube":
        return _latin_hypercube(stream, count, campaign.runs)
    if campaign.sampling == "saltelli":
        return _saltelli(stream, campaign)
    from scipy.stats import qmc

    whole = qmc.Sobol(count, seed=stream).random_base2((campaign.runs - 1).bit_length())
    return np.asarray(whole)[: campaign.runs].T.copy()


def _latin_hypercube(stream: np.random.Generator, count: int, runs: int) -> FloatArray:
    """As `scipy.stats.qmc.LatinHypercube`, without its import, which takes as long as a dozen runs."""
    (own,) = stream.spawn(1)
    within = own.uniform(size=(runs, count)).T
    strata = np.tile(np.arange(1, runs + 1), (count, 1))
    for row in strata:
        own.shuffle(row)
    return np.asarray((strata - within) / runs)


def _saltelli(stream: np.random.Generator, campaign: Campaign) -> FloatArray:
    from SALib.sample import sobol

    samples = campaign.runs // (len(campaign.factor_names) + 2)
    design = sobol.sample(sensitivity_problem(campaign), samples, calc_second_order=False, seed=stream)
    return np.asarray(design, dtype=np.float64).T.copy()


def _triangles(campaign: Campaign, path: str) -> list[tuple[list[str], FloatArray]]:
    """Groups of correlated keys, each with the Cholesky factor of its correlation matrix."""
    found = []
    for i, joint in enumerate(campaign.joint_normals):
        sigma = np.array(_sigmas(joint))
        matrix = np.array(joint.covariance) / (sigma[:, None] * sigma)
        found.append((joint.keys, _triangle(matrix, path, f"joint_normals.{i}.covariance")))
    for i, correlation in enumerate(campaign.correlations):
        matrix = np.array(correlation.matrix)
        found.append((correlation.keys, _triangle(matrix, path, f"correlations.{i}.matrix")))
    return found


def _triangle(matrix: FloatArray, path: str, key: str) -> FloatArray:
    try:
        return np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        least = Finding(f"a smallest eigenvalue of {np.linalg.eigvalsh(matrix)[0]:.3g} times the variances")
        raise InputError(path, key, least, "use a positive definite matrix") from None


def _correlated(probability: FloatArray, lower: FloatArray) -> FloatArray:
    """(keys, runs) Correlate independent probabilities by a Gaussian copula."""
    from scipy.special import ndtr, ndtri

    independent = ndtri(np.clip(probability, _NEAREST_END, 1 - _NEAREST_END))
    correlated = np.zeros_like(probability)
    # Term by term, since the summation order of a matrix product depends on the library.
    for i, row in enumerate(lower):
        for j in range(i + 1):
            correlated[i] += row[j] * independent[j]
    return np.asarray(ndtr(correlated))


def _values_at(distribution: Distribution, probability: FloatArray) -> list[Any]:
    """Map probabilities (n,) within (0, 1) to the values of a scenario key."""
    match distribution:
        case Choice():
            return [distribution.of[i] for i in _chosen(distribution, probability)]
        case Integer():
            count = distribution.high - distribution.low + 1
            return [distribution.low + min(int(u * count), count - 1) for u in probability.tolist()]
        case _:
            return [float(value) for value in _numbers(distribution, probability)]


def _numbers(distribution: Uniform | Normal | Lognormal | Triangular, probability: FloatArray) -> FloatArray:
    from scipy.special import ndtri

    match distribution:
        case Uniform():
            return distribution.low + probability * (distribution.high - distribution.low)
        case Normal(low=None, high=None):
            return distribution.mean + distribution.sigma * np.asarray(ndtri(probability))
        case Normal():
            return _truncated(distribution, probability)
        case Lognormal():
            return distribution.median * np.exp(distribution.sigma_log * np.asarray(ndtri(probability)))
    return _triangular(distribution, probability)


def _truncated(normal: Normal, probability: FloatArray) -> FloatArray:
    low = -math.inf if normal.low is None else normal.low
    high = math.inf if normal.high is None else normal.high
    ends = (low - normal.mean) / normal.sigma, (high - normal.mean) / normal.sigma
    values = normal.mean + normal.sigma * truncated_quantile(probability, *ends)
    return np.clip(values, low, high)  # against rounding errors


def truncated_quantile(probability: FloatArray, low: float, high: float) -> FloatArray:
    """As `scipy.stats.truncnorm.ppf`: from the tail in which the lower bound lies, in logarithms."""
    from scipy.special import log1p, log_ndtr, logsumexp, ndtr, ndtri_exp

    if low <= 0.0 < high:
        log_mass = log1p(-ndtr(low) - ndtr(-high))
    else:
        tails = (high, low) if high <= 0.0 else (-low, -high)
        log_mass = np.real(logsumexp([log_ndtr(tails[0]), log_ndtr(tails[1]) + np.pi * 1j]))
    tail, share = (low, np.log(probability)) if low < 0.0 else (-high, np.log1p(-probability))
    beyond = np.full_like(probability, log_ndtr(tail))
    value = np.asarray(ndtri_exp(logsumexp([beyond, share + log_mass], axis=0)))
    return value if low < 0.0 else -value


def _triangular(triangular: Triangular, probability: FloatArray) -> FloatArray:
    low, mode, high = triangular.low, triangular.mode, triangular.high
    rising = low + np.sqrt(probability * (high - low) * (mode - low))
    falling = high - np.sqrt((1 - probability) * (high - low) * (high - mode))
    return np.where(probability * (high - low) < mode - low, rising, falling)


def _chosen(choice: Choice, probability: FloatArray) -> list[int]:
    weights = np.array(choice.weights or [1.0] * len(choice.of))
    ends = np.cumsum(weights) / weights.sum()
    # By rounding, the last end may be less than 1; a probability above it belongs to the last value with a weight.
    return [
        int(i)
        for i in np.minimum(np.searchsorted(ends, probability, side="right"), np.flatnonzero(weights)[-1])
    ]
