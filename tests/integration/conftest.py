"""Programs and far ends that end with the test, and the measurements to which the wire is held."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import cache
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # handwritten.py and its neighbours are modules of these tests

from programs import FarEnd, Program

import lidar_emu
from lidar_emu.measurement import Measurement

StartProgram = Callable[..., Program]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[StartProgram]:
    """Start `lidar-emu` with these arguments, in the test's own folder; `started=True` as a process of its own."""
    programs: list[Program] = []

    def begin(*arguments: str, started: bool = False) -> Program:
        program = Program(list(arguments), tmp_path, f"program{len(programs)}", started)
        programs.append(program)
        return program

    yield begin
    for program in programs:
        program.end()


@pytest.fixture
def far_end() -> Iterator[FarEnd]:
    """See `FarEnd`."""
    with closing(FarEnd()) as end:
        yield end


@pytest.fixture
def other_end() -> Iterator[FarEnd]:
    """A second one, for a program that listens."""
    with closing(FarEnd()) as end:
        yield end


@cache
def _simulated(scenario: str, overrides: tuple[tuple[str, str], ...]) -> Measurement:
    return lidar_emu.simulate(lidar_emu.load(scenario, dict(overrides)))


@pytest.fixture
def simulated() -> Callable[..., Measurement]:
    """`lidar_emu.simulate` of a scenario with overrides, computed once."""

    def simulate(scenario: str, **overrides: str) -> Measurement:
        return _simulated(scenario, tuple((key.replace("__", "."), text) for key, text in overrides.items()))

    return simulate
