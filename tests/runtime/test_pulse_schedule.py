"""When the port is to give pulses: at the times of validity that packets state, for shots that will be measured."""

from __future__ import annotations

from typing import Any

import pytest

import lidar_emu
from lidar_emu.errors import InputError
from lidar_emu.runtime.options import RunOptions
from lidar_emu.runtime.port.packets import Pace
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.runtime.prepare import prepare
from lidar_emu.runtime.run import Run
from lidar_emu.shots.model import build_model
from lidar_emu.transports.spec import Kind, PortSpec

KEYS = {"site": "flat", "duration_s": "0.3", "device.clock.pulse_out": "dtr"}


def told(monkeypatch: pytest.MonkeyPatch, pace: Pace, **keys: str) -> tuple[int | None, list[Any]]:
    calls: list[Any] = []
    monkeypatch.setattr(PortRunner, "set_pulses", lambda _self, *call: calls.append(call))
    scenario = lidar_emu.load("descent.yaml", {**KEYS, **keys})
    run = Run(scenario, build_model(scenario), RunOptions(PortSpec(), pace), [])  # type: ignore[arg-type]
    run.fly()
    return run.start_ns, calls


@pytest.mark.parametrize("turns", ["together", "in_turn"])
def test_pulses_begin_at_the_times_of_validity(monkeypatch: pytest.MonkeyPatch, turns: str) -> None:
    keys = {"scanner.firing": turns}
    start_ns, calls = told(monkeypatch, Pace.WALL, **keys)
    assert start_ns is not None
    valid_ns = lidar_emu.simulate("descent.yaml", {**KEYS, **keys}).time_ns[:, 0]
    ((first_ns, period_ns, firing),) = calls
    assert firing == [(0, 1), (len(valid_ns), 0)]
    assert [first_ns + shot * period_ns - start_ns for shot in range(len(valid_ns))] == valid_ns.tolist()
    assert valid_ns[0] > 0


def test_as_fast_as_possible_there_are_none(monkeypatch: pytest.MonkeyPatch) -> None:
    assert told(monkeypatch, Pace.MAX)[1] == []


def test_a_port_without_lines_is_told_before_the_run() -> None:
    scenario = lidar_emu.load("descent.yaml", KEYS)
    model: Any = build_model(scenario)  # type: ignore[arg-type]
    warnings = prepare(scenario, model, RunOptions(PortSpec(Kind.UDP, "127.0.0.1:9"))).warnings
    assert warnings == ["udp:127.0.0.1:9 has no modem lines: device.clock.pulse_out has no effect"]
    scenario = lidar_emu.load("descent.yaml", {**KEYS, "device.clock.pulse_out": "rts"})
    with pytest.raises(InputError, match="--rs485 switches RTS"):
        prepare(scenario, model, RunOptions(PortSpec(Kind.SERIAL, "/dev/ttyS0", rs485=True)))
