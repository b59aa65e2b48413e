"""Rules that hold everywhere in the source, read off its syntax trees."""

from __future__ import annotations

import ast
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
GLOBAL_CHANCE = {
    "random.random",
    "random.seed",
    "np.random.rand",
    "np.random.randn",
    "np.random.seed",
    "os.urandom",
}


@cache
def calls(path: Path) -> frozenset[str]:
    tree = ast.walk(ast.parse(path.read_text()))
    return frozenset(ast.unparse(node.func) for node in tree if isinstance(node, ast.Call))


def test_there_are_sources():
    assert len(SOURCES) > 100
    assert CLOCK_FILE in SOURCES


def test_one_file_reads_the_clock():
    assert CLOCK_READERS & calls(CLOCK_FILE)
    readers = [str(path) for path in SOURCES if path != CLOCK_FILE and CLOCK_READERS & calls(path)]
    assert readers == []


def test_nobody_draws_from_a_global_generator():
    assert [str(path) for path in SOURCES if GLOBAL_CHANCE & calls(path)] == []
