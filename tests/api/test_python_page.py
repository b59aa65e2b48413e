"""docs/python.md: its blocks run one after the other, as printed."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import lidar_emu

PAGE = Path(__file__).resolve().parents[2] / "docs" / "python.md"
BLOCK = re.compile(r"(<!-- not run: [^\n]* -->\n)?```python\n(.*?)```", re.DOTALL)
NOT_RUN = 2


def test_blocks_run_as_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    blocks = BLOCK.findall(PAGE.read_text(encoding="utf-8"))
    assert sum(bool(mark) for mark, _ in blocks) == NOT_RUN
    for number, (mark, text) in enumerate(blocks):
        if not mark:
            exec(compile(text, f"block {number} of {PAGE.name}", "exec"), names)
    printed = capsys.readouterr().out
    assert "overrides: timing.rate_hz: -100 is not usable; allowed: greater than or equal to 0.001" in printed
    assert "shot 15" in printed
    ours_mmps, own_mmps = map(float, re.findall(r"speed error, mm/s: ([\d.]+)", printed))
    assert own_mmps < ours_mmps


def test_every_name_is_shown() -> None:
    text = PAGE.read_text(encoding="utf-8")
    results = {
        "__version__",
        "BenchScenario",
        "CampaignResults",
        "FlightScenario",
        "GroundTruth",
        "Measurement",
    }
    unshown = {name for name in lidar_emu.__all__ if name not in text}
    assert unshown <= results | {"RunError", "shipped_scenarios"}
