"""Options of a run, and checks against the scenario."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from enum import StrEnum

from lidar_emu.errors import Finding, InputError
from lidar_emu.ip_addresses import endpoint, is_this_machine
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.port.packets import Pace
from lidar_emu.scenario.schema import Scenario
from lidar_emu.scenario.trajectory import Live
from lidar_emu.transports.spec import Kind, PortSpec

_HOST_LIMIT_S = 60.0


class StartEvent(StrEnum):
    """The event that starts a run."""

    NOW = "now"
    """The first shots are computed."""
    ON_CONNECT = "on-connect"
    """The other end has opened the port."""
    ON_TRUTH = "on-truth"
    """The first live truth arrives, which defines scenario time 0."""
    ON_COMMAND = "on-command"
    """A command makes the device acquire."""


@dataclass(frozen=True)
class RunOptions:
    """Options of a run."""

    port: PortSpec
    pace: Pace = Pace.WALL
    start: StartEvent | datetime | None = None
    """Event, or UTC instant of scenario time 0; None: with live truth its arrival, on a port that shows its host the
    opening by it, otherwise now."""
    wait_limit_s: float | None = None
    """Limit of the wait for the event; None: a minute for a host, none for truth and commands."""
    control: str | None = None
    """Path of the socket on which faults are injected in flight; None: there is none."""


def live_part(scenario: Scenario, options: RunOptions) -> Live | None:
    """The live trajectory of a scenario; None if it has another one.

    Raises:
        InputError: the pace does not suit it, or truth and packets would have one address.
    """
    live = scenario.live
    if live is None and options.pace is Pace.LOCKSTEP:
        raise InputError("--pace", None, "lockstep", "must be wall or max unless trajectory.kind is live")
    if live is not None and options.pace is Pace.MAX:
        raise InputError("--pace", None, "max", "must be wall or lockstep with trajectory.kind live")
    if live is not None and options.port.kind is Kind.UDP and _is_same(live.listen, options.port.path):
        remedy = "must be another port than trajectory.listen, where truth arrives"
        raise InputError("--port", None, str(options.port), remedy)
    return live


def _is_same(listen: str, port: str) -> bool:
    """Whether datagrams to a port arrive where truth does."""
    there, here = endpoint(port), endpoint(listen.removeprefix("udp:"))
    hosts_are_same = there.host == here.host or (
        is_this_machine(there.host) and (is_this_machine(here.host) or here.host in ("", "0.0.0.0", "::"))
    )
    return listen.startswith("udp:") and there.port == here.port and hosts_are_same


def start_of(scenario: Scenario, options: RunOptions) -> StartEvent | datetime:
    """What starts the run.

    Raises:
        InputError: the start does not suit scenario, port or pace.
    """
    start, port = options.start, options.port
    if scenario.live is not None:
        default, remedy = StartEvent.ON_TRUTH, "on-truth (the default) or an instant"
        is_allowed = start is StartEvent.ON_TRUTH or isinstance(start, datetime)
        if options.pace is Pace.LOCKSTEP:
            is_allowed, remedy = start is StartEvent.ON_TRUTH, "on-truth (the default)"
        circumstances = f"live truth and --pace {options.pace}"
    else:
        default = default_start(port)
        events = {StartEvent.NOW}
        if port.shows_host:
            events.add(StartEvent.ON_CONNECT)
        if port.kind is not Kind.LOOPBACK and options.pace is Pace.WALL:
            events.add(StartEvent.ON_COMMAND)
        is_allowed = start in events or isinstance(start, datetime)
        remedy = f"{', '.join(sorted(events))} or an instant; the default is {default}"
        circumstances = f"{port} and --pace {options.pace}"
    if start is not None and not is_allowed:
        found = start.isoformat() if isinstance(start, datetime) else str(start)
        raise InputError("--start", None, Finding(f"{found} with {circumstances}"), f"use {remedy}")
    return default if start is None else start


def default_start(port: PortSpec) -> StartEvent:
    """What starts a planned flight or a replay on a port, unless the user states it."""
    return StartEvent.ON_CONNECT if port.shows_host else StartEvent.NOW


def wait_limit_s(start: StartEvent | datetime, stated_s: float | None) -> float | None:
    """Limit of the wait for what starts a run; None: there is none."""
    return _HOST_LIMIT_S if stated_s is None and start is StartEvent.ON_CONNECT else stated_s


def start_instant_ns(start: StartEvent | datetime, clock: Clock) -> int | None:
    """Scenario time 0 on the monotonic clock; None if the feed defines it.

    Raises:
        InputError: it lies in the past.
    """
    now_ns, now = clock.now_ns(), clock.utc_now()
    if not isinstance(start, datetime):
        return None
    if start < now:
        raise InputError("--start", None, start.isoformat(), "must be now or a future instant")
    return now_ns + (start - now) // timedelta(microseconds=1) * 1000
