"""Requirements on the runs of a campaign: their file, and the value of each run that a requirement judges.

A requirement states a limit of one value per run and the probability with which a run meets it. Shots of a run share
its dispersed values and are not independent; a requirement on shots is therefore judged by runs: a run meets it if a
`share` of its shots in the bands keeps the limit. Its value is the order statistic that decides this.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lidar_emu.campaign.statistics import ERRORS
from lidar_emu.campaign.tables import OUTCOMES, read_columns
from lidar_emu.errors import Finding, did_you_mean, listed, nearest, one_line, shown
from lidar_emu.measurement import TABLE
from lidar_emu.numerics.arrays import FloatArray, Group, IntArray
from lidar_emu.scenario.explain import Source, validated
from lidar_emu.scenario.section import Fraction, Part, unusable
from lidar_emu.scenario.yaml_text import read_mapping

_ERRORS = {f"{error.name}_abs": error.quantity for error in ERRORS}
"""Measured quantity behind each magnitude of an error."""
_SHOT_QUANTITIES = [*_ERRORS, *(name for name, column in TABLE.items() if column.group is Group.REPORT)]
_ROUNDING = 1e-9
"""Share of a beam by which a product such as 0.07 * 100 exceeds the whole number that is meant."""

_Band = tuple[float, float]
Stated = tuple[str, str | None, Sequence[str]]
"""A key, the quantity stated by it, and the quantities that it may state."""


class Requirement(Part):
    """A limit of a quantity, and the probability with which a run must keep it."""

    id: str
    """Identifier: letters, digits and `_ ( ) . / : -`, without blanks."""
    text: str
    """The requirement in words, for reports."""
    at_most: float | None = None
    """Largest value that meets the requirement."""
    at_least: float | None = None
    """Least value that meets the requirement."""
    altitude_m: _Band | None = None
    """Altitudes, both ends included: above the site's origin in a campaign, above the ground in a trial. Left out:
    all."""
    share: Fraction = 1.0
    """Share of a run's values in the bands that must keep the limit, for the run to meet the requirement."""
    probability: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Required probability that a run meets the requirement. Left out, in a trial: all that are flown must."""
    confidence: Annotated[float, Field(ge=0.5, lt=1)] = 0.9
    """Confidence with which the probability is to be shown."""

    def _check(self) -> None:
        if not re.fullmatch(r"\w[\w()./:-]{0,99}", self.id):
            raise unusable(
                "id", self.id, "up to 100 letters, digits and _ ( ) . / : -, a letter or digit first"
            )
        if not one_line(self.text):
            raise unusable("text", Finding("empty"), "state the requirement")
        whole, each = self._quantities()
        (key, quantity, known), other = (whole, each) if whole[1] is not None else (each, whole)
        if (quantity is None) == (other[1] is None):
            raise unusable(whole[0], Finding("no quantity, or two"), f"state either {whole[0]} or {each[0]}")
        if quantity is not None and quantity not in known:
            hint = did_you_mean(nearest(quantity, known))
            raise unusable(key, Finding(f"no quantity {shown(quantity)}"), f"{hint}known: {listed(known)}")
        if (self.at_most is None) == (self.at_least is None):
            raise unusable("at_most", Finding("no limit, or two"), "state either at_most or at_least")
        for name in self.model_fields_set & {"altitude_m", "range_m", "share"}:
            if key == whole[0]:
                raise unusable(name, Finding(f"a key of {each[0]}s"), f"state {each[0]}, or remove it")
        for name in ("altitude_m", "range_m"):
            band = getattr(self, name, None)
            if band is not None and not band[0] < band[1]:
                raise unusable(name, list(band), "two ascending numbers")

    def _quantities(self) -> tuple[Stated, Stated]:
        """Key, stated quantity and known ones: of a value per run, and of many of which a share keeps the limit."""
        raise NotImplementedError

    @property
    def quantity(self) -> str:
        return next(str(name) for _, name, _ in self._quantities() if name is not None)

    @property
    def limit(self) -> float:
        limit = self.at_least if self.at_most is None else self.at_most
        assert limit is not None
        return limit

    @property
    def sign(self) -> float:
        """Factor after which the lower of two values is the better one."""
        return -1.0 if self.at_most is None else 1.0


class CampaignRequirement(Requirement):
    """A requirement on the runs of a campaign, or on their shots."""

    run: str | None = None
    """Quantity of a run: a column of the table `runs`."""
    shot: str | None = None
    """Quantity of the beams of a shot: `range_error_m_abs`, `speed_error_mps_abs`, or a measured column of the table
    `beams`."""
    range_m: _Band | None = None
    """True ranges, both ends included. Left out: all."""
    probability: Annotated[float, Field(gt=0, lt=1)]
    """Required probability that a run meets the requirement."""
    confidence: Annotated[float, Field(ge=0.5, lt=1)]
    """Confidence with which the probability is to be shown."""

    def _quantities(self) -> tuple[Stated, Stated]:
        return ("run", self.run, OUTCOMES), ("shot", self.shot, _SHOT_QUANTITIES)


def refuse_repeated(key: str, ids: Sequence[str]) -> None:
    """Refuse an identifier that is stated twice in a list.

    Raises:
        PydanticCustomError: as `unusable` makes it.
    """
    for i, name in enumerate(ids):
        if name in ids[:i]:
            raise unusable(f"{key}.{i}.id", name, "stated once")


class RequirementsFile(Part):
    """Requirements that a campaign verifies."""

    requirements: Annotated[list[CampaignRequirement], Field(min_length=1, max_length=1000)]
    """The requirements."""

    def _check(self) -> None:
        refuse_repeated("requirements", [requirement.id for requirement in self.requirements])


def read_requirements(path: Path) -> list[CampaignRequirement]:
    """Read and check a file of requirements.

    Raises:
        InputError: names the file, the key, the value that cannot be used, and what can.
    """
    return validated(RequirementsFile, read_mapping(path), {(): Source(str(path))}).requirements


class RunValues(NamedTuple):
    """The runs that judge a requirement, and their values."""

    run: IntArray
    """(runs,) Numbers of the runs."""
    seed: IntArray
    """(runs,) Their seeds."""
    value: FloatArray
    """(runs,) Their values; NaN where a run failed or measured nothing that the requirement judges."""


def read_run_values(
    requirements: Sequence[CampaignRequirement], folder: Path, beams_every: int
) -> list[RunValues]:
    """Read the values of all runs of a finished campaign, for each requirement.

    Args:
        requirements: the requirements.
        folder: folder of the campaign's tables.
        beams_every: beams are stored for every nth run; only these judge requirements on shots.

    Raises:
        InputError: a file is damaged.
    """
    parts = [
        list(_part_values(requirements, path, beams_every))
        for path in sorted((folder / "runs").glob("part-*"))
    ]
    return [
        RunValues(*(np.concatenate(columns) for columns in zip(*values, strict=True)))
        for values in zip(*parts, strict=True)
    ]


def _part_values(
    requirements: Sequence[CampaignRequirement], path: Path, beams_every: int
) -> Iterator[RunValues]:
    of_runs = [one.quantity for one in requirements if one.run is not None]
    runs = read_columns(path, list(dict.fromkeys(("run", "seed", *of_runs))))
    of_shots = [name for one in requirements if one.shot is not None for name in _columns(one)]
    beams_path = path.parent.parent / "beams" / path.name
    # There is no file of beams where all runs failed, or none of them keeps its beams.
    stored = of_shots and beams_path.exists()
    beams = read_columns(beams_path, list(dict.fromkeys(of_shots))) if stored else None
    with_beams = runs["run"] % beams_every == 0
    for requirement in requirements:
        if requirement.run is not None:
            yield RunValues(runs["run"], runs["seed"], runs[requirement.quantity].astype(np.float64))
            continue
        run = runs["run"][with_beams]
        value = np.full(run.size, np.nan) if beams is None else shot_values(requirement, beams, run)
        yield RunValues(run, runs["seed"][with_beams], value)


def _columns(requirement: CampaignRequirement) -> list[str]:
    measured = _ERRORS.get(requirement.quantity)
    quantity = [requirement.quantity] if measured is None else [measured, f"true_{measured}"]
    return ["run", "fired", "true_range_m", "altitude_m", *quantity]


def shot_values(
    requirement: CampaignRequirement, beams: Mapping[str, NDArray[Any]], runs: IntArray
) -> FloatArray:
    """(runs,) The value that decides for each run: it keeps the limit if, and only if, `share` of the beams do.

    Beams count that fired at the ground, lie in the bands and have a value.

    Args:
        requirement: a requirement on shots.
        beams: columns of the table `beams`; NaN where a value is missing.
        runs: numbers of the runs; NaN is returned for those of which no beam counts.
    """
    measured = _ERRORS.get(requirement.quantity)
    if measured is None:
        value = requirement.sign * beams[requirement.quantity].astype(np.float64)
    else:
        value = requirement.sign * np.abs(beams[measured] - beams[f"true_{measured}"])
    counted = beams["fired"] & np.isfinite(beams["true_range_m"]) & np.isfinite(value)
    bands = {"altitude_m": requirement.altitude_m, "true_range_m": requirement.range_m}
    for name, band in bands.items():
        if band is not None:
            counted &= (beams[name] >= band[0]) & (beams[name] <= band[1])
    run, value = beams["run"][counted], value[counted]
    order = np.lexsort((value, run))
    run, value = run[order], value[order]
    first = np.searchsorted(run, runs, side="left")
    count = np.searchsorted(run, runs, side="right") - first
    rank = deciding_rank(requirement.share, count)
    decisive = np.full(runs.size, np.nan)
    known = count > 0
    decisive[known] = requirement.sign * value[(first + rank - 1)[known]]
    return decisive


def deciding_rank(share: float, count: IntArray) -> IntArray:
    """Rank, from 1 for the best, of the value that keeps a limit if, and only if, a share of `count` values does."""
    rank: IntArray = np.maximum(np.ceil(share * count - _ROUNDING), 1).astype(np.int64)
    return rank
