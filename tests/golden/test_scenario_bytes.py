"""The bytes of shipped scenarios are part of the interface: a change is deliberate, or a mistake."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import pytest

_TOOL = Path(__file__).parents[2] / "tools" / "scenario_bytes.py"
_QUICK = ("bench", "paper_fig4 spectral", "paper_fig4 geometric")


def _tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("scenario_bytes", _TOOL)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


TOOL = _tool()


@pytest.mark.parametrize(
    "case", [case if case in _QUICK else pytest.param(case, marks=pytest.mark.slow) for case in TOOL.cases()]
)
def test_a_shipped_scenario_sends_the_pinned_bytes(case: str) -> None:
    pinned = json.loads(TOOL.PINNED.read_text())
    found = TOOL.digests(case)
    # Not the columns: their last digits may differ on another family of processors.
    assert (found["packets"], found["bytes"]) == (pinned[case]["packets"], pinned[case]["bytes"])


def test_no_pinned_case_has_gone() -> None:
    assert set(json.loads(TOOL.PINNED.read_text())) == set(TOOL.cases())
