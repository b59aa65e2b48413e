"""The receiver's kernel compiled in a second process, while this one compiles others."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from numba import typeof
from numba.core import config
from numba.core.registry import cpu_target

from lidar_emu.numerics import compilation
from lidar_emu.numerics.compilation import compile_beside, report_compilation
from lidar_emu.numerics.compiler import KernelCache
from lidar_emu.receiver import receiver
from lidar_emu.scenario.load import load, shipped_scenarios
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.shots.model import build_model
from lidar_emu.shots.receiver_compilation import RECEIVER


@pytest.fixture
def events(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.setattr(compilation, "_starts", {})
    monkeypatch.setattr(compilation, "_waits", {})
    events = list[str]()
    compile_beside("large", lambda: events.append("start") or (lambda: events.append("wait")))
    return events


def test_the_second_process_starts_with_the_first_other_kernel(events: list[str]) -> None:
    assert not report_compilation("small")
    assert not report_compilation("second")
    assert events == ["start"]
    assert report_compilation("large"), "the cache may have it"
    assert events == ["start", "wait"]
    assert not report_compilation("large"), "of other types: compiled here"
    assert events == ["start", "wait"]


def test_no_process_starts_where_its_kernel_is_the_first(events: list[str]) -> None:
    assert not report_compilation("large")
    assert not report_compilation("small")
    assert events == []


@pytest.mark.slow
def test_the_second_process_leaves_what_every_scenario_looks_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = [sys.executable, "-P", "-m", "lidar_emu.shots.receiver_compilation"]
    subprocess.run(command, env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}, check=True)
    (compiled,) = (tmp_path / "kernels").iterdir()
    assert compiled.name.startswith(RECEIVER)

    kernel, called = receiver.measure_beams, list[tuple[Any, ...]]()

    def note(*args: Any) -> Any:
        called.append(tuple(map(typeof, args)))
        return kernel(*args)

    monkeypatch.setattr(receiver, "measure_beams", note)
    flown = [load(name) for name in shipped_scenarios()]
    flown = [each for each in flown if isinstance(each, FlightScenario) and each.live is None]
    for scenario in flown:
        model = build_model(scenario.with_(level="spectral"))
        model.measure(0, 1, model.initial_state)
    assert len(called) >= len(flown) > 10
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    codegen = cpu_target.target_context.codegen()
    assert {KernelCache(kernel)._path(types, codegen) for types in called} == {compiled}
