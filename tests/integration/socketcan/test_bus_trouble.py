"""A bus that is slow, loses frames, goes down, reports errors or is flooded: the run continues and reports it."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import slcan_lines
from can_tools import candump, send
from programs import LONG_BENCH, Program, read_summary
from waiting import eventually

from lidar_emu.errors import InputError
from lidar_emu.transports.can_port import open_can
from lidar_emu.transports.spec import Kind, PortSpec

BEAMS = 4
BUS = ["-i", "socketcan", "-c", "vcan0", "--bitrate", "1000000"]
SIMPLE = ["--set", "level=geometric", "--set", "site=flat", "--set", "timing.late_after_s=60"]

Start = Callable[..., Program]
Shape = Callable[..., None]
SetInterface = Callable[..., None]


def events(summary: dict[str, Any]) -> list[str]:
    return [event["what"] for event in summary["link_events"]]


def test_a_slow_bus_drops_whole_shots(start: Start, shape: Shape, tmp_path: Path) -> None:
    shape("tbf", "rate", "100kbit", "burst", "64", "limit", "160")
    fast = ["--set", "timing.rate_hz=900", "--set", "wire.can_messages=core", "--duration", "1"]
    with candump(tmp_path) as dump:
        start("run", "descent.yaml", *BUS, *SIMPLE, *fast, "--summary", "s.json").succeed()
    summary = read_summary(tmp_path / "s.json")
    shots = summary["shots"]
    assert shots["dropped"]["full"] > 0
    assert shots["dropped"]["broken"] == 0
    assert shots["sent"] + shots["late"] + shots["dropped"]["full"] == shots["due"]
    assert shots["due"] == summary["planned_shots"]
    decoded = slcan_lines.shots(dump.frames())
    assert len(decoded) == shots["sent"]
    assert {len(shot["messages"]) for shot in decoded} == {1 + BEAMS}


def test_an_interface_goes_down_and_comes_back_in_flight(
    start: Start, set_interface: SetInterface, tmp_path: Path
) -> None:
    with candump(tmp_path) as dump:
        run = start("run", *LONG_BENCH, *BUS, "--summary", "s.json")
        eventually(dump.frames)
        set_interface("vcan0", "down")
        threading.Event().wait(0.5)
        before = len(dump.frames())
        set_interface("vcan0", "up")
        eventually(lambda: len(dump.frames()) > before + 50)
        run.signal(signal.SIGINT)
        run.succeed()
    summary = read_summary(tmp_path / "s.json")
    assert events(summary) == ["link broken: Network is down", "reopened"]
    assert summary["shots"]["dropped"]["broken"] > 0


def test_errors_on_the_bus_are_reported(start: Start, tmp_path: Path) -> None:
    with candump(tmp_path) as dump:
        run = start("run", *LONG_BENCH, *BUS, "--summary", "s.json")
        eventually(dump.frames)
        for error_class, controller in ((0x4, 0x08), (0x8, 0), (0x4, 0x20), (0x40, 0)):
            send(0x20000000 | error_class, bytes([0, controller, 0, 0, 0, 0, 0, 0]))
        before = len(dump.frames())
        eventually(lambda: len(dump.frames()) > before + 100)
        run.signal(signal.SIGINT)
        run.succeed()
    summary = read_summary(tmp_path / "s.json")
    states = [f"CAN controller: error {state}" for state in ("warning", "passive")]
    assert events(summary) == [*states, "link broken: bus off", "reopened"]
    assert summary["wire"]["error_frames"] == 4


def test_a_dead_interface_is_refused_before_the_run(set_interface: SetInterface) -> None:
    set_interface("vcan1", "down")
    with pytest.raises(InputError, match="down: ip link set vcan1 up"):
        open_can(PortSpec(Kind.CAN, interface="socketcan", channel="vcan1"))
    set_interface("vcan1", "mtu", "16", "up")
    with pytest.raises(InputError, match="classic frames only"):
        open_can(PortSpec(Kind.CAN, interface="socketcan", channel="vcan1", fd=True))
    open_can(PortSpec(Kind.CAN, interface="socketcan", channel="vcan1")).close()


@pytest.mark.parametrize("bus", [BUS, [*BUS, "--fd"]], ids=["classic", "fd"])
def test_errors_and_bus_off_on_order(bus: list[str], start: Start, tmp_path: Path) -> None:
    faults = (
        "[{kind: error_frames, rate_hz: 50, from_s: 0.5, to_s: 1.5}, {kind: bus_off, from_s: 2, to_s: 2.5}]"
    )
    control = str(tmp_path / "control")
    with candump(tmp_path) as dump:
        run = start(
            "run", *LONG_BENCH, *bus, "--set", f"faults={faults}", "--control", control, "--summary", "s.json"
        )
        eventually(lambda: newest_shot(dump.frames()) > 25)
        inject = start("inject", control, "{kind: bus_off, lasts_s: 0.5}")
        assert inject.wait() == 0, inject.err
        injected_at = newest_shot(dump.frames())
        eventually(lambda: newest_shot(dump.frames()) > injected_at + 30)
        run.signal(signal.SIGINT)
        run.succeed()
    summary = read_summary(tmp_path / "s.json")
    assert events(summary) == ["link broken: bus off by an injected fault", "reopened"] * 2
    assert summary["wire"]["error_frames"] == 50
    assert summary["shots"]["dropped"]["broken"] > 0
    assert len(slcan_lines.shots(dump.frames())) == summary["shots"]["sent"], "whole or not at all"


def newest_shot(frames: list[slcan_lines.Line]) -> int:
    """Number of the newest shot of which the message with the number is there."""
    return max((shot.get("shot", 0) for shot in slcan_lines.shots(frames)), default=0)
