"""The one table of effects by level: what validators and faults refuse, and the page that prints it."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import pytest

from lidar_emu.errors import InputError
from lidar_emu.scenario import faults
from lidar_emu.scenario.effects_by_level import COLUMNS, EFFECTS, FULL_RATE, markdown
from lidar_emu.scenario.load import load
from lidar_emu.scenario.schema import FlightScenario

PAGE = Path(__file__).resolve().parents[2] / "docs" / "evidence" / "accuracy.md"
ASKED_FOR = {
    "instrument.optics.speckle": "off",
    "instrument.detection.looks": "2",
    "instrument.detection.rule": "any_two",
    "instrument.detection.peak": "jacobsen",
}
"""A value for each key that asks for an effect."""


def test_every_key_is_tried_here() -> None:
    assert {effect.key for effect in EFFECTS if effect.key} == ASKED_FOR.keys()


@pytest.mark.parametrize("effect", [effect for effect in EFFECTS if effect.key], ids=lambda each: each.name)
@pytest.mark.parametrize("column", COLUMNS)
def test_a_level_without_an_effect_refuses_its_key(effect, column: str) -> None:
    level, _, full_rate = column.partition(",")
    keys = {effect.key: ASKED_FOR[effect.key], "level": level, "timing.rate_hz": "10"}
    keys["instrument.detection.combine"] = "least_squares"
    if full_rate:
        keys["reference_samples"] = "full_rate"
    if column in effect.levels or column == "geometric":
        load("descent", keys)
        return
    with pytest.raises(InputError) as refused:
        load("descent", keys)
    assert refused.value.key == effect.key
    assert f"must be {effect.remedy} at level {level}" in str(refused.value)


def test_full_rate_samples_belong_to_the_reference() -> None:
    with pytest.raises(InputError, match="reference_samples: must be narrowband, or level reference with it"):
        load("descent", {"reference_samples": "full_rate"})


def test_every_fault_of_light_and_receiver_has_its_row() -> None:
    kinds = (*get_args(faults.LightFault), *get_args(faults.ReceiverFault))
    named = {f"fault {get_args(kind.model_fields['kind'].annotation)[0]}" for kind in kinds}
    assert named == {effect.name for effect in EFFECTS if effect.name.startswith("fault ")}


def test_every_level_has_its_column() -> None:
    levels = get_args(FlightScenario.model_fields["level"].annotation)
    assert sorted(COLUMNS) == sorted((*levels, FULL_RATE))


def test_the_page_has_the_table() -> None:
    shown = PAGE.read_text().split("<!-- effects: begin -->\n\n")[1].split("\n<!-- effects: end -->")[0]
    assert shown == markdown(), "print it from lidar_emu.scenario.effects_by_level.markdown()"
