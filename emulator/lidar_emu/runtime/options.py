"""Options of a run, and checks against the scenario."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime, timedelta

from lidar_emu.errors import Finding, InputError
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.port.pacing import Pace
from lidar_emu.scenario.schema import Scenario
from lidar_emu.scenario.trajectory import Live
from lidar_emu.transports.spec import Kind, PortSpec


@dataclass(frozen=True)
class RunOptions:
    """Options of a run."""

    port: PortSpec
    pace: Pace = Pace.WALL
    start: datetime | None = None
    """UTC instant of scenario time 0; None: as soon as the first shots are computed or, with live truth, as the first
    datagram defines it."""
    on_command: bool = False
    """Scenario time 0 follows the command that makes the device acquire."""
    control: str | None = None
    """Path of the socket on which faults are injected in flight; None: there is none."""


def live_part(scenario: Scenario, options: RunOptions) -> Live | None:
    """The live trajectory of a scenario; None if it has another one.

    Raises:
        InputError: the pace or the start does not suit it.
    """
    live = scenario.live
    if live is None and options.pace is Pace.LOCKSTEP:
        raise InputError(
            "--pace", None, "lockstep", "allowed with trajectory.kind live: wall, lockstep; else wall, max"
        )
    if live is not None and options.pace is Pace.MAX:
        raise InputError("--pace", None, "max", "allowed with trajectory.kind live: wall, lockstep")
    if options.pace is Pace.LOCKSTEP and options.start is not None:
        raise InputError(
            "--start", None, options.start.isoformat(), "allowed in lockstep: on-truth (the default)"
        )
    if options.on_command and (live is not None or options.pace is not Pace.WALL):
        found = "trajectory.kind live" if live is not None else f"pace {options.pace}"
        raise InputError(
            "--start", None, Finding(f"on-command with {found}"), "allowed: a planned flight at pace wall"
        )
    if options.on_command and options.port.kind is Kind.LOOPBACK:
        raise InputError(
            "--start",
            None,
            Finding("on-command on the in-memory loopback"),
            "allowed with --port or --interface",
        )
    return live


def port_of(scenario: Scenario, options: RunOptions) -> PortSpec:
    """The port, with the pulse line of the scenario."""
    return replace(options.port, pulse_line=scenario.device.clock.pulse_line or "")


def start_instant_ns(options: RunOptions, clock: Clock) -> int | None:
    """Scenario time 0 on the monotonic clock; None if the feed defines it.

    Raises:
        InputError: it lies in the past.
    """
    start, now_ns, now = options.start, clock.now_ns(), clock.utc_now()
    if start is None:
        return None
    if start < now:
        raise InputError("--start", None, start.isoformat(), "allowed: now, or a future instant")
    return now_ns + (start - now) // timedelta(microseconds=1) * 1000
