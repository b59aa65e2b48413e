"""The file of a campaign, and the scenarios of its runs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from lidar_emu.campaign.draw import DrawnValues, draw
from lidar_emu.errors import Finding, InputError
from lidar_emu.scenario.campaign import (
    Campaign,
)
from lidar_emu.scenario.explain import Source, explained
from lidar_emu.scenario.load import (
    find_file,
    find_file_or_pipe,
    read_scenario,
    require_flight,
    require_known_flight,
)
from lidar_emu.scenario.parts import CAMPAIGN, ChangedKey, plain_mapping
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
        # Parents first, so that keys can be set within a part that is chosen by name.
        stated = sorted({**self.fixed, **values}.items(), key=lambda item: item[0].count("."))
        changes = [ChangedKey(key, deepcopy(value), CAMPAIGN) for key, value in stated]
        scenario = require_flight(read_scenario(Path(self.scenario), changes))
        require_known_flight(scenario)
        return scenario


@dataclass(frozen=True)
class PreparedCampaign:
    """A campaign with its drawn values, ready to be flown."""

    campaign: Campaign
    base: Base
    drawn: DrawnValues
    first: FlightScenario
    """Scenario of the first valid run."""


def read_campaign(stated: Path | Mapping[str, Any], runs: int | None = None) -> tuple[Path, Campaign]:
    """Read and check a campaign, and return its source as well: the path of its file, or `campaign` for a mapping.

    Args:
        stated: path of its file, the name of a shipped campaign, or a mapping with the keys of a file.
        runs: number of runs from `--runs`; None: as in the file.

    Raises:
        InputError: names the file, the key, the value that cannot be used, and what can.
    """
    if isinstance(stated, Mapping):
        found = _IN_PYTHON
        tree = plain_mapping(stated, str(found))
    else:
        found = find_file_or_pipe(stated, "campaigns")
        tree = read_mapping(found)
    sources: dict[Key, Source] = {(): Source(str(found))}
    if runs is not None:
        tree["runs"] = runs
        sources["runs",] = Source("--runs", outer=1)
    try:
        return found, Campaign.model_validate_json(json.dumps(tree))
    except ValidationError as error:
        raise explained(error, Campaign, tree, sources) from None


def prepare(
    stated: Path | Mapping[str, Any], changes: Sequence[ChangedKey], runs: int | None
) -> PreparedCampaign:
    """Read a campaign and draw its values.

    Args:
        stated: path of its file, the name of a shipped campaign, or a mapping with the keys of a file. A scenario
            that a mapping names is relative to the working directory.
        changes: keys that all runs have instead of the campaign's and the scenario's.
        runs: number of runs; None: as in the file.

    Raises:
        InputError: the campaign or its scenario cannot be used, or the first runs are all invalid.
    """
    found, campaign = read_campaign(stated, runs)
    for change in changes:
        if change.key in campaign.drawn_keys:
            remedy = f"set keys that {found} does not draw"
            raise InputError(change.stated_by, change.key, Finding("drawn"), remedy)
    beside = found.parent / campaign.scenario
    scenario = find_file(beside if beside.is_file() else Path(campaign.scenario), "scenarios")
    fixed = campaign.set | {change.key: change.value for change in changes}
    base = Base(str(scenario.resolve()), fixed)
    drawn = draw(campaign, str(found))
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
