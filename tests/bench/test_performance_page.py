"""`make performance` writes tables between the markers of the page; CI keeps the ratio of every benchmark."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

from lidar_emu.cli.bench import bench

TOOLS = Path(__file__).resolve().parents[2] / "tools"


@pytest.fixture
def performance(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(TOOLS))
    module = __import__("performance")
    monkeypatch.delitem(sys.modules, "performance")
    return module


def test_only_the_text_between_the_markers_changes(
    performance: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- t: begin -->\nold\n<!-- t: end -->\nafter\n")
    monkeypatch.setattr(performance, "PAGE", page)
    monkeypatch.setitem(
        performance.TABLES, "t", [lambda: [("", "us"), ("one", "1")], lambda: [("x",), ("2",)]]
    )
    performance.update("t")
    performance.update("t")
    lines = page.read_text().splitlines()
    assert lines[:5] == ["before", "<!-- t: begin -->", "|  | us |", "|---|---|", "| one | 1 |"]
    assert lines[6:9] == ["| x |", "|---|", "| 2 |"]
    assert lines[10].startswith("Measured 20")
    assert lines[11:] == ["<!-- t: end -->", "after"]


def test_the_page_has_a_place_for_every_table(performance: ModuleType) -> None:
    text = performance.PAGE.read_text()
    for name in performance.TABLES:
        assert text.count(f"<!-- {name}: begin -->") == text.count(f"<!-- {name}: end -->") == 1


def test_every_benchmark_has_its_ratio(performance: ModuleType) -> None:
    assert set(performance.BENCHES) == set(bench.commands)


@pytest.mark.slow
def test_a_ratio_is_read_from_what_the_command_prints(
    performance: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(performance, "BENCHES", {"protocol": ([], [])})
    performance.write_ratios(tmp_path / "new" / "ratios.json")
    written = json.loads((tmp_path / "new" / "ratios.json").read_text())["ratios"]["protocol"]
    assert written["ratio"] > 1
    assert written["of"] == "time of the slow exact path to ours, packet, built"
