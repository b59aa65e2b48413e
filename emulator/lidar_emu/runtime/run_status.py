"""Status of a run or a replay: its start, its end and the events of its processes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime, timedelta
from typing import Any

from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.lateness_statistics import steal_ticks
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.status import EventLog, PortStatus, events_to_json
from lidar_emu.runtime.signals import on_signals
from lidar_emu.transports.spec import PortSpec


class RunStatus:
    """Start, interruption, error and process events of a run or a replay.

    Args:
        observers: receive the process events.
    """

    def __init__(self, observers: Sequence[Observer]) -> None:
        self._observers = observers
        self._process_events = EventLog()
        self._steal_ticks: int | None = None
        self.opening = True
        """Whether the port is being opened."""
        self.interrupted = False
        self.error: str | None = None
        """Why the run ended early, if that is an error."""
        self._wait: tuple[int, str] | None = None
        self.start_utc: datetime | None = None
        """Scenario time 0; None as long as no flight has begun."""

    @property
    def stopped(self) -> bool:
        """Whether the run was interrupted or failed."""
        return self.interrupted or self.error is not None

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Let SIGINT (Ctrl-C), SIGTERM and SIGHUP interrupt the run, and count the host's steal ticks from here on.

        An interruption takes effect between packets, because an exception at an arbitrary point could lose reports
        just fetched. While the port is being opened there is nothing to lose and no loop that would check, so the
        signals raise KeyboardInterrupt.
        """
        self._steal_ticks = steal_ticks()
        with on_signals(self._interrupt):
            yield

    def ready(self, port: str) -> None:
        """The port is open: from here on a signal ends the run between packets."""
        self.opening = False
        for observer in self._observers:
            observer.on_ready(port)

    def wait_for(self, what: str, port: str, limit_s: float | None, now_ns: int) -> None:
        """Begin to wait for the event that starts the run, from `now_ns` on; `limit_s` None: without a limit."""
        limit = ""
        if limit_s is not None:
            error = f"{port}: waited {limit_s:g} s for {what}; --wait-limit S allows more"
            self._wait, limit = (now_ns + round(limit_s * 1e9), error), f", at most {limit_s:g} s"
        for observer in self._observers:
            observer.on_waiting(port, what + limit)

    def may_wait(self, now_ns: int) -> bool:
        """Whether the run may go on waiting; fails the run once the limit has passed."""
        if self._wait is not None and now_ns >= self._wait[0]:
            self.fail(self._wait[1])
        return not self.stopped

    def begin(self, start_ns: int, clock: Clock) -> datetime:
        """Set the start to an instant of the monotonic clock; returns it as UTC."""
        now_ns, now = clock.now_ns(), clock.utc_now()
        self.start_utc = now + timedelta(microseconds=(start_ns - now_ns) / 1000)
        return self.start_utc

    def fail(self, error: str) -> None:
        """Record why the run ends early; the first error counts."""
        self.error = self.error or error

    def on_stall(self, time_ns: int, what: str) -> None:
        """Record that a process stalled or resumed."""
        self._process_events.add(self._process_events.count + 1, time_ns, what)
        for observer in self._observers:
            observer.on_event("process", time_ns, what)

    def to_json(self, spec: PortSpec, port: PortStatus, load: float | None) -> dict[str, Any]:
        """Status of the run and of the port, by the keys of the summary file.

        Args:
            spec: port as the user stated it, for a port that was not opened.
            port: status of the port.
            load: share of the link's capacity that the packets take.
        """
        before, now = self._steal_ticks, steal_ticks()
        return {
            "started_utc": None if self.start_utc is None else self.start_utc.isoformat(),
            "interrupted": self.interrupted,
            "error": self.error,
            "port": port.description or str(spec),
            "steal_ticks": None if before is None or now is None else now - before,
            **port.to_json(load),
            **events_to_json("process", self._process_events.count, self._process_events.since(0)),
        }

    def _interrupt(self, *_: object) -> None:
        self.interrupted = True
        if self.opening:
            raise KeyboardInterrupt
