"""Rules that hold everywhere in the source, read off its syntax trees."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted([*(ROOT / "emulator").rglob("*.py"), *(ROOT / "protocol").rglob("*.py")])
CLOCK_FILE = ROOT / "emulator" / "lidar_emu" / "runtime" / "clock.py"
CLOCK_READERS = {
    "time.time", "time.time_ns", "time.monotonic", "time.monotonic_ns", "time.perf_counter", "time.perf_counter_ns",
    "time.process_time", "time.process_time_ns", "time.sleep",
    "datetime.now", "datetime.utcnow", "datetime.today", "date.today",
}  # fmt: skip


def nodes(path: Path) -> Iterator[ast.AST]:
    return ast.walk(ast.parse(path.read_text()))


@cache
def calls(path: Path) -> frozenset[str]:
    return frozenset(ast.unparse(node.func) for node in nodes(path) if isinstance(node, ast.Call))


def test_there_are_sources():
    assert len(SOURCES) > 100
    assert CLOCK_FILE in SOURCES


def test_one_file_reads_the_clock():
    assert CLOCK_READERS & calls(CLOCK_FILE)
    readers = [str(path) for path in SOURCES if path != CLOCK_FILE and CLOCK_READERS & calls(path)]
    assert readers == []


def test_no_two_classes_share_a_name():
    places: dict[str, list[str]] = defaultdict(list)
    for path in SOURCES:
        for node in nodes(path):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert {name: found for name, found in places.items() if len(found) > 1} == {}
