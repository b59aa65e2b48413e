"""Status of a run or a replay: its start, its end and the events of its processes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime, timedelta
from typing import Any

from lidar_emu.runtime.change_queue import ChangeQueue
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.packets import Pace, Pacing
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.runtime.port.status import EventLog, PortStatus, events_to_json
from lidar_emu.runtime.signals import on_signals
from lidar_emu.runtime.summary import steal_ticks
from lidar_emu.transports.spec import PortSpec

POLL_NS = 20_000_000
"""Longest time until an interruption takes effect."""
_SETTLED_NS = 100_000_000
"""A program that only sets the terminal (`stty`) closes the port sooner than that."""


class RunStatus:
    """Start, interruption, error and process events of a run or a replay.

    Args:
        observers: receive its start and the process events.
        pacing: when packets are sent.
        clock: clock of the run.
    """

    def __init__(self, observers: Sequence[Observer], pacing: Pacing, clock: Clock) -> None:
        self.observers = observers
        """Receive its start and the process events; may be replaced before the port is opened."""
        self.clock = clock
        self._pacing = pacing
        self._port: PortRunner
        self._process_events = EventLog()
        self._steal_ticks: int | None = None
        self._opening = True
        self.interrupted = False
        self.error: str | None = None
        """Why the run ended early, if that is an error."""
        self._wait: tuple[int, str] | None = None
        self.start_ns: int | None = None
        """Instant of the monotonic clock at scenario time 0; None as long as no flight has begun."""
        self._start_utc: datetime | None = None

    @property
    def stopped(self) -> bool:
        """Whether the run was interrupted or failed."""
        return self.interrupted or self.error is not None

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Let SIGINT (Ctrl-C), SIGTERM and SIGHUP interrupt the run, and count the host's steal ticks from here on.

        An interruption takes effect between packets; while the port is being opened, it raises KeyboardInterrupt.
        """
        # An exception at an arbitrary point could lose reports just fetched. While the port is being opened there is
        # nothing to lose, and no loop that would check.
        self._steal_ticks = steal_ticks()
        with on_signals(self._interrupt):
            yield

    def ready(self, port: PortRunner) -> None:
        """The port is open: from here on a signal ends the run between packets."""
        self._opening, self._port = False, port
        if self._pacing.pace is Pace.WALL:
            port.request_realtime()
        for observer in self.observers:
            observer.on_ready(port.status.description)

    def wait_for(self, what: str, limit_s: float | None) -> None:
        """Begin to wait for the event that starts the run; `limit_s` None: without a limit."""
        port, limit = self._port.status.description, ""
        if limit_s is not None:
            error = f"{port}: waited {limit_s:g} s for {what}; --wait-limit S allows more"
            self._wait = self.clock.now_ns() + round(limit_s * 1e9), error
            limit = f", at most {limit_s:g} s"
        for observer in self.observers:
            observer.on_waiting(port, what + limit)

    def may_wait(self) -> bool:
        """Whether the run may go on waiting for its start; fails the run once the limit has passed."""
        if self._wait is not None and self.clock.now_ns() >= self._wait[0]:
            self.fail(self._wait[1])
        return not self.stopped

    def begin(self, start_ns: int) -> None:
        """Begin the flight: scenario time 0 is at this instant of the monotonic clock."""
        now_ns, now = self.clock.now_ns(), self.clock.utc_now()
        self.start_ns, self._start_utc = start_ns, now + timedelta(microseconds=(start_ns - now_ns) / 1000)
        for observer in self.observers:
            observer.on_opened(self._port.status.description, self._start_utc)
        pacing = self._pacing
        self._port.begin(start_ns, pacing.late_after_ns, pacing.pace, pacing.when_late, pacing.poll_ns)

    def fail(self, error: str) -> None:
        """End the run with an error; the first one counts."""
        self.error = self.error or error

    def on_stall(self, time_ns: int, what: str) -> None:
        """Record that a process stalled or resumed."""
        self._process_events.add(self._process_events.count + 1, time_ns, what)
        for observer in self.observers:
            observer.on_event("process", time_ns, what)

    def to_json(self, spec: PortSpec, port: PortStatus, load: float | None) -> dict[str, Any]:
        """Status of the run and of the port, by the keys of the summary file.

        Args:
            spec: port as the user stated it, for a port that was not opened.
            load: share of the link's capacity that the packets take.
        """
        before, now = self._steal_ticks, steal_ticks()
        return {
            "started_utc": None if self._start_utc is None else self._start_utc.isoformat(),
            "interrupted": self.interrupted,
            "error": self.error,
            "port": port.description or str(spec),
            "steal_ticks": None if before is None or now is None else now - before,
            **port.to_json(load),
            **events_to_json("process", self._process_events.count, self._process_events.since(0)),
        }

    def _interrupt(self, *_: object) -> None:
        self.interrupted = True
        if self._opening:
            raise KeyboardInterrupt


def wait_for_host(status: RunStatus, port: PortRunner, changes: ChangeQueue | None = None) -> bool:
    """Wait until the other end has had the port open for a tenth of a second.

    Args:
        changes: meanwhile receives commands and injected faults, which affect the flight from its first shot on.

    Returns:
        Whether the host is there; False: the wait was ended.

    Raises:
        PortDiedError: the port process died.
    """
    since_ns: int | None = None
    while status.may_wait():
        if changes is not None:
            changes.receive(0)
        now_ns = status.clock.now_ns()
        if not port.status.connected:
            since_ns = None
        elif since_ns is None:
            since_ns = now_ns
        elif now_ns - since_ns >= _SETTLED_NS:
            return True
        port.wait(now_ns + POLL_NS)
    return False
