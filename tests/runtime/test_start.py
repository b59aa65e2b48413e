"""What starts a run, and how long it waits for that, on times that the test chooses."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from types import SimpleNamespace
from typing import Any

import pytest

from lidar_emu.errors import InputError
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.options import RunOptions, StartEvent, start_of, wait_limit_s
from lidar_emu.runtime.port.packets import Pace, Pacing
from lidar_emu.runtime.port.status import PortStatus
from lidar_emu.runtime.prepare import prepare
from lidar_emu.runtime.run_status import RunStatus, wait_for_host
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model
from lidar_emu.transports.spec import Kind, PortSpec, parse_port

MS = 1_000_000
SECOND_NS = 1_000_000_000
PTY, URL = PortSpec(Kind.PTY), PortSpec(Kind.SERIAL, "socket://127.0.0.1:5600")
DEVICE, UDP = PortSpec(Kind.SERIAL, "/dev/ttyUSB0"), PortSpec(Kind.UDP, "127.0.0.1:5600")
CAN, LOOPBACK = PortSpec(Kind.CAN, interface="socketcan", channel="vcan0"), PortSpec()
AT_NOON = datetime(2030, 1, 1, 12, tzinfo=UTC)


@pytest.mark.parametrize(
    ("port", "expected"),
    [
        (PTY, StartEvent.ON_CONNECT),
        (URL, StartEvent.ON_CONNECT),
        (PortSpec(Kind.TCP, "127.0.0.1:5600"), StartEvent.ON_CONNECT),
        (PortSpec(Kind.UNIX, "/tmp/lidar"), StartEvent.ON_CONNECT),
        (DEVICE, StartEvent.NOW),
        (UDP, StartEvent.NOW),
        (CAN, StartEvent.NOW),
        (LOOPBACK, StartEvent.NOW),
    ],
    ids=str,
)
@pytest.mark.parametrize("pace", [Pace.WALL, Pace.MAX])
def test_a_run_waits_for_a_host_where_the_port_shows_one(
    port: PortSpec, expected: StartEvent, pace: Pace
) -> None:
    assert start_of(load("bench.yaml"), RunOptions(port, pace)) is expected


@pytest.mark.parametrize("pace", [Pace.WALL, Pace.LOCKSTEP])
def test_live_truth_starts_a_run_on_any_port(pace: Pace) -> None:
    assert start_of(load("live.yaml"), RunOptions(PTY, pace)) is StartEvent.ON_TRUTH


@pytest.mark.parametrize("start", [StartEvent.NOW, StartEvent.ON_CONNECT, StartEvent.ON_COMMAND, AT_NOON])
def test_the_user_may_state_another_start(start: StartEvent | datetime) -> None:
    assert start_of(load("bench.yaml"), RunOptions(PTY, start=start)) == start


@pytest.mark.parametrize(
    ("scenario", "options", "allowed"),
    [
        ("bench.yaml", RunOptions(UDP, start=StartEvent.ON_CONNECT), "now, on-command or an instant"),
        ("bench.yaml", RunOptions(LOOPBACK, start=StartEvent.ON_COMMAND), "now or an instant"),
        ("bench.yaml", RunOptions(PTY, Pace.MAX, StartEvent.ON_COMMAND), "now, on-connect or an instant"),
        (
            "bench.yaml",
            RunOptions(PTY, start=StartEvent.ON_TRUTH),
            "now, on-command, on-connect or an instant",
        ),
        ("live.yaml", RunOptions(PTY, start=StartEvent.NOW), "on-truth (the default) or an instant"),
        ("live.yaml", RunOptions(PTY, start=StartEvent.ON_CONNECT), "on-truth (the default) or an instant"),
        ("live.yaml", RunOptions(PTY, Pace.LOCKSTEP, AT_NOON), "on-truth (the default)"),
    ],
)
def test_a_start_that_cannot_happen_is_refused(scenario: str, options: RunOptions, allowed: str) -> None:
    with pytest.raises(InputError, match=r"^--start: ") as refused:
        start_of(load(scenario), options)
    assert f"use {allowed}" in str(refused.value)


def test_only_the_wait_for_a_host_is_limited_unless_the_user_limits_another() -> None:
    assert wait_limit_s(StartEvent.ON_CONNECT, None) == 60.0
    assert [wait_limit_s(event, None) for event in (StartEvent.ON_COMMAND, StartEvent.ON_TRUTH)] == [None] * 2
    assert {wait_limit_s(event, 7.0) for event in StartEvent} == {7.0}


class Notes(Observer):
    """Keeps what the run waits for."""

    def __init__(self) -> None:
        self.waits: list[tuple[str, str]] = []

    def on_waiting(self, port: str, what: str) -> None:
        self.waits.append((port, what))


def waiting_status(now_ns: int, what: str, limit_s: float | None, *observers: Observer) -> tuple[Any, Any]:
    """The status of a run that waits from `now_ns` on, and the clock that it reads."""
    clock: Any = SimpleNamespace(now=now_ns)
    clock.now_ns = lambda: clock.now
    status = RunStatus(observers, Pacing(Pace.WALL, 0), clock)
    any_port: Any = SimpleNamespace(status=PortStatus("/dev/pts/9"), request_realtime=lambda: None)
    status.ready(any_port)
    status.wait_for(what, limit_s)
    return status, clock


def test_the_limit_ends_the_wait_with_an_error_that_names_port_event_and_option() -> None:
    notes = Notes()
    status, clock = waiting_status(SECOND_NS, "a host to open it", 5.0, notes)
    assert notes.waits == [("/dev/pts/9", "a host to open it, at most 5 s")]
    clock.now = 6 * SECOND_NS - 1
    assert status.may_wait()
    assert status.error is None
    clock.now = 6 * SECOND_NS
    assert not status.may_wait()
    assert status.error == "/dev/pts/9: waited 5 s for a host to open it; --wait-limit S allows more"


def test_without_a_limit_only_an_interruption_ends_the_wait() -> None:
    status, clock = waiting_status(0, "truth on unix:t", None)
    clock.now = 10**6 * SECOND_NS
    assert status.may_wait()
    status.interrupted = True
    assert not status.may_wait()
    assert status.error is None


class Port:
    """A port that its host opens and closes at chosen instants; it is also the clock, which only waiting moves."""

    def __init__(self, *changes_ms: int) -> None:
        self.now = 0
        self._changes_ns = [change * MS for change in changes_ms]
        self.status = PortStatus()

    def now_ns(self) -> int:
        return self.now

    def wait(self, until_ns: int) -> None:
        pending = [change for change in self._changes_ns if change > self.now]
        self.now = min(until_ns, *pending[:1], until_ns)
        self.status.connected = sum(change <= self.now for change in self._changes_ns) % 2 == 1


def waited_ms(port: Any, may_wait: Callable[[], bool]) -> float | None:
    """When the host was there; None: the wait was given up."""
    status: Any = SimpleNamespace(clock=port, may_wait=may_wait)
    return port.now / MS if wait_for_host(status, port) else None


@pytest.mark.parametrize(
    ("changes_ms", "begins_ms"),
    [
        ((1000,), 1100),  # opened once and for good
        ((1000, 1010, 3000), 3100),  # `stty` sets the terminal, `cat` opens it later
        ((0, 50, 60, 130, 140), 240),  # opened and closed all the time: counted from the last opening
        ((), None),
        ((1000, 1050), None),
    ],
)
def test_the_host_is_there_once_it_has_stayed(changes_ms: tuple[int, ...], begins_ms: int | None) -> None:
    port = Port(*changes_ms)
    began_ms = waited_ms(port, lambda: port.now < 60 * SECOND_NS)
    assert began_ms == begins_ms if begins_ms is None else began_ms == pytest.approx(begins_ms, abs=20)


def test_a_run_warns_of_telecommands_from_other_machines() -> None:
    scenario = load("bench.yaml")
    model = build_model(scenario)
    line = "tcp:0.0.0.0:5600 is open to other machines: any of them may command the device"
    assert prepare(scenario, model, RunOptions(parse_port("tcp:0.0.0.0:5600"), Pace.WALL)).warnings == [line]
    assert prepare(scenario, model, RunOptions(parse_port("tcp:5600"), Pace.WALL)).warnings == []
