"""The line of an error, its way from one process to another, and what it costs."""

from __future__ import annotations

import pickle

import pytest
from pydantic import BaseModel

from lidar_emu.errors import Finding, InputError, shown
from lidar_emu.scenario import explain
from lidar_emu.scenario.load import load

ERRORS = {
    "a.yaml: timing.rate_hz: must be a number (got 'fast')": (
        "a.yaml",
        "timing.rate_hz",
        "fast",
        "must be a number",
    ),
    "a.yaml: must be a mapping (got [1, null])": ("a.yaml", None, [1, None], "must be a mapping"),
    "a.yaml: site: missing; this key is required": (
        "a.yaml",
        "site",
        Finding("missing"),
        "this key is required",
    ),
    "a.yaml: seed: must be a number (got a value of type object)": (
        "a.yaml",
        "seed",
        object(),
        "must be a number",
    ),
}


@pytest.mark.parametrize("line", ERRORS)
def test_line(line: str) -> None:
    assert str(InputError(*ERRORS[line])) == line


def test_long_values_and_line_breaks_are_shortened() -> None:
    line = str(InputError("a.yaml", "name", "x\n" * 100, "must be short"))
    assert "\n" not in line
    assert line.endswith("...)")
    assert len(shown("x" * 100)) == 60


@pytest.mark.parametrize("value", ["fast", 3, Finding("missing"), [1, 2]])
def test_an_error_can_be_pickled(value: object) -> None:
    error = InputError("a.yaml", "seed", value, "must be a number")
    copy = pickle.loads(pickle.dumps(error))
    assert str(copy) == str(error)
    assert (copy.where, copy.key, copy.value, copy.remedy) == ("a.yaml", "seed", value, "must be a number")
    assert type(copy.value) is type(value)


def test_the_schema_is_made_once_for_any_number_of_complaints(monkeypatch):
    """A campaign may draw thousands of values that are not allowed; making the schema takes a quarter of a second."""
    made = []
    make = BaseModel.model_json_schema.__func__
    monkeypatch.setattr(
        BaseModel, "model_json_schema", classmethod(lambda model: made.append(model) or make(model))
    )
    explain._schema.cache_clear()
    for share in ("2", "3", "4"):
        with pytest.raises(InputError, match="less than or equal to 1"):
            load("descent.yaml", {"site.surface.reflectance": share})
    assert len(made) == 1
