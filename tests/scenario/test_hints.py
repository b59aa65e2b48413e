"""Hints at misspelled keys: the key that was meant, at every place of the schema, and none for any other word."""

import difflib
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidar_emu import simulate
from lidar_emu.errors import InputError
from lidar_emu.scenario.campaign import Campaign
from lidar_emu.scenario.hints import meant_key
from lidar_emu.scenario.load import load, shipped_scenarios
from lidar_emu.scenario.schema import BenchScenario, FlightScenario


def choices(schema, node):
    if "$ref" in node:
        node = schema["$defs"][node["$ref"].rpartition("/")[2]]
    below = [*node.get("anyOf", ()), *node.get("oneOf", ())]
    for choice in below:
        yield from choices(schema, choice)
    if not below:
        yield node


def places(schema, node, key, around):
    """Every mapping: the schema, its key, its keys, and what makes a scenario of its content."""
    for one in choices(schema, node):
        keys = one.get("properties", {})
        kind = {"kind": keys["kind"]["const"]} if "const" in keys.get("kind", {}) else {}

        def whole(content, kind=kind):
            return around({**kind, **content})

        if keys:
            yield schema, key, list(keys), whole
        for name, below in keys.items():
            yield from places(schema, below, (*key, name), lambda inner, n=name, w=whole: w({n: inner}))
        if isinstance(one.get("items"), dict):
            yield from places(schema, one["items"], (*key, 0), lambda inner: around([inner]))


SCHEMAS = [model.model_json_schema() for model in (FlightScenario, BenchScenario, Campaign)]
PLACES = [place for schema in SCHEMAS for place in places(schema, schema, (), lambda content: content)]


def hint(place, name, value=1):
    schema, key, names, whole = place
    return meant_key(schema, whole({name: value}), key, names, name)


def shortened(name):
    return {name} | {name[:k] + name[k + 1 :] for k in range(len(name))}


@given(st.randoms(use_true_random=False))
def test_a_letter_wrong_in_any_key_leads_to_the_key(draw):
    place = draw.choice(PLACES)
    for name in (name for name in place[2] if len(name) > 3):
        k, letter = draw.randrange(len(name)), draw.choice("abcdexyz_")
        before, after = name[:k], name[k + 1 :]
        swapped = before + after[:1] + name[k] + after[1:]
        typos = {before + after, before + letter + after, before + letter + name[k:], swapped}
        for found, typo in ((hint(place, typo), typo) for typo in typos - {*place[2]}):
            # Another key may be as near: map_x_m and map_y_m, and more among short names.
            is_near = found is not None and (len(name) < 8 or shortened(str(found[-1])) & shortened(typo))
            assert found == (*place[1], name) or is_near


UNITS = {"m": "km", "hz": "khz", "s": "ms", "w": "mw", "mps": "kmps", "deg": "rad", "mrad": "rad"}


def test_a_key_in_another_unit_or_without_one_leads_to_the_key():
    keys = [(place, *name.rpartition("_")) for place in PLACES for name in place[2] if "_per_" not in name]
    keys = [(place, stem, unit) for place, stem, _, unit in keys if stem and unit in UNITS]
    assert len(keys) > 400
    for place, stem, unit in keys:
        for other in {stem, f"{stem}_{UNITS[unit]}"} - {*place[2]}:
            *above, name = hint(place, other)
            assert (*above, name.rpartition("_")[0]) == (*place[1], stem)


@pytest.mark.parametrize(
    "word", ["xyzzy", "colour", "banana", "x", "d", "jazz", "verbose", "0", "é", "m_s_", "_"]
)
def test_other_words_lead_nowhere(word):
    assert not any(hint(place, word, {"name": 1}) for place in PLACES)


MOVED = {
    "instrument.laser_power_mw": "instrument.optics.laser_power_w",
    "timing.rte": "timing.rate_hz",
    "duration": "duration_s",
    "scanner.switches.0.angle_deg": "scanner.switches.0.pattern.angle_deg",
    "speed_mps": "trajectory.waypoints.0.speed_mps",
    "kind": "trajectory.kind",
    "Timing": "timing",
}


@pytest.mark.parametrize(("key", "meant"), MOVED.items())
def test_a_hint_is_a_key_that_is_accepted_in_this_place(key, meant):
    for stated, line in ((key, f"{key}: no such key; did you mean {meant}? "), (meant, f"{meant}: must be ")):
        with pytest.raises(InputError, match=f"^overrides: {re.escape(line)}"):
            simulate("descent", **{stated: "x"})


def test_what_is_accepted_pays_for_no_hint(monkeypatch):
    monkeypatch.delattr(difflib, "get_close_matches")
    for name in shipped_scenarios():
        load(name)
