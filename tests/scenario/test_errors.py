"""The line of an error, and its way from one process to another."""

from __future__ import annotations

import pickle

import pytest

from lidar_emu.errors import Finding, InputError, shown

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
