"""Reading a campaign's file, and the scenario that its runs fly."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from lidar_emu.campaign.draw import Drawn, draw
from lidar_emu.errors import Finding, InputError
from lidar_emu.scenario.campaign import Campaign
from lidar_emu.scenario.explain import Source, explained
from lidar_emu.scenario.load import find_file, load
from lidar_emu.scenario.required import require_flight, require_known_flight
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scenario.yaml_text import Key, parse, read_mapping

_FIRST_RUNS = 16


@dataclass(frozen=True)
class Base:
    """What all runs have in common; small enough to be sent to wherever they are flown."""

    scenario: str
    """Path."""
    fixed: dict[str, Any]
    """Dotted keys and values that all runs have."""

    def scenario_of(self, values: Mapping[str, Any]) -> FlightScenario:
        """The scenario of a run that sets these values.

        Raises:
            InputError: one of them is not allowed, or the scenario is no flight that is known beforehand.
        """
        # Parents first, so that a part that is chosen by name can have keys of its own.
        stated = sorted({**self.fixed, **values}.items(), key=lambda item: item[0].count("."))
        scenario = require_flight(load(self.scenario, campaign=dict(stated)))
        require_known_flight(scenario)
        return scenario


@dataclass(frozen=True)
class PreparedCampaign:
    """What is to be flown."""

    campaign: Campaign
    base: Base
    drawn: Drawn
    first: FlightScenario
    """The first run that can be."""


def read_campaign(path: Path, runs: int | None = None) -> tuple[Path, Campaign]:
    """Where a campaign is, and what it says.

    Args:
        path: of its file, or the name of a shipped one.
        runs: instead of its own, as `--runs` says.

    Raises:
        InputError: names the file, key and value that cannot be used, and what is allowed.
    """
    found = find_file(path, "campaigns")
    tree = read_mapping(found)
    sources: dict[Key, Source] = {(): Source(str(found))}
    if runs is not None:
        tree["runs"] = runs
        sources["runs",] = Source("--runs", outer=1)
    try:
        return found, Campaign.model_validate_json(json.dumps(tree))
    except ValidationError as error:
        raise explained(error, Campaign, tree, sources) from None


def prepare(path: Path, overrides: Mapping[str, str], runs: int | None) -> PreparedCampaign:
    """A campaign ready to be flown.

    Args:
        path: of its file, or the name of a shipped one.
        overrides: dotted keys of the scenario and YAML values, of the command line.
        runs: instead of the campaign's own.

    Raises:
        InputError: the campaign or its scenario cannot be used, or none of the first runs.
    """
    found, campaign = read_campaign(path, runs)
    for key in overrides:
        if key in campaign.drawn_keys:
            raise InputError("--set", key, Finding("drawn"), f"allowed: keys that {found} does not draw")
    beside = found.parent / campaign.scenario
    scenario = find_file(beside if beside.is_file() else Path(campaign.scenario), "scenarios")
    fixed = campaign.set | {key: parse(text, f"--set {key}") for key, text in overrides.items()}
    base = Base(str(scenario.resolve()), fixed)
    drawn = draw(campaign, str(found))
    return PreparedCampaign(campaign, base, drawn, _first_flown(base, drawn, campaign.runs))


def _first_flown(base: Base, drawn: Drawn, runs: int) -> FlightScenario:
    """A run that may be drawn too far out is a run that failed; a key that no run can have is a mistake."""
    refusal: InputError | None = None
    for run in range(min(runs, _FIRST_RUNS)):
        try:
            return base.scenario_of(drawn.values(run))
        except InputError as error:
            refusal = refusal or error
    assert refusal is not None
    raise refusal
