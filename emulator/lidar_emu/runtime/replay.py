"""Replay: recorded packets are sent again over a port when they are due."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from datetime import datetime, timedelta
from typing import Any

from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.feed.base import POLL_NS
from lidar_emu.runtime.lateness_statistics import steal_ticks
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.child import PortDiedError
from lidar_emu.runtime.port.pacing import Pace
from lidar_emu.runtime.port.packets import OutgoingPacket
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.runtime.port.status import EventLog, events_to_json
from lidar_emu.runtime.signals import on_signals
from lidar_emu.runtime.summary import Tally
from lidar_emu.transports.spec import PortSpec

_SLOTS = 1024
_LEAD_NS = 100_000_000
LATE_AFTER_NS = 100_000_000
"""A packet that is later than this is skipped: no burst follows a stall."""


class Replay:
    """A replay of packets over a port.

    Args:
        packets: numbered from 0, in the order in which they are due.
        longest: length of the longest packet, in bytes.
        port: the port.
        pace: by the clock, or as fast as the link takes them.
        load: share of the link's capacity that the packets take.
        observers: called in the loop: they must be quick.
    """

    def __init__(
        self,
        packets: Iterable[OutgoingPacket],
        longest: int,
        port: PortSpec,
        pace: Pace,
        load: float,
        observers: Sequence[Observer],
    ) -> None:
        self._packets, self._longest = packets, longest
        self._spec, self._pace, self._load = port, pace, load
        self._observers = observers
        self._clock = Clock()
        self._process_events = EventLog()
        self._in_flight: list[OutgoingPacket] = []
        self._opening = True
        self._interrupted = False
        self._start_utc: datetime | None = None
        self.tally = Tally(pace)
        self.error: str | None = None
        """Why it ended early, if that is an error."""

    def play(self) -> dict[str, Any]:
        """Send to the end, or until SIGINT, SIGTERM or SIGHUP; return the summary.

        Raises:
            InputError: the port cannot be opened.
            RunError: the port process did not start. If it dies later, the replay ends with its summary.
        """
        stolen = steal_ticks()
        with on_signals(self._interrupt), PortRunner(_SLOTS, self._longest, self._on_stall) as port:
            with suppress(KeyboardInterrupt):
                description = port.start(self._spec)
                self._opening = False
                try:
                    self._send(port, description)
                except PortDiedError as death:
                    self.error = str(death)
            port.close()
            self._collect_reports(port)
        stolen_now = steal_ticks()
        shots = self.tally.to_json()["shots"]
        return {
            "started_utc": None if self._start_utc is None else self._start_utc.isoformat(),
            "interrupted": self._interrupted,
            "error": self.error,
            "port": port.status.description or str(self._spec),
            "packets": {name: shots[name] for name in ("due", "sent", "late", "dropped")},
            "lateness": self.tally.to_json()["lateness"],
            "steal_ticks": None if stolen is None or stolen_now is None else stolen_now - stolen,
            **port.status.to_json(self._load),
            **events_to_json("process", self._process_events.count, self._process_events.since(0)),
        }

    def _send(self, port: PortRunner, description: str) -> None:
        start_ns, now = self._clock.now_ns() + _LEAD_NS, self._clock.utc_now()
        self._start_utc = now + timedelta(microseconds=_LEAD_NS / 1000)
        for observer in self._observers:
            observer.on_opened(description, self._start_utc)
        port.begin(start_ns, LATE_AFTER_NS, self._pace)
        for packet in self._packets:
            while not (self._interrupted or port.push(packet)):
                self._wait_for_reports(port)
            if self._interrupted:
                return
            self._in_flight.append(packet)
            self._collect_reports(port)
        port.end_packets()
        while not (port.finished or self._interrupted):
            self._wait_for_reports(port)

    def _wait_for_reports(self, port: PortRunner) -> None:
        port.wait(self._clock.now_ns() + POLL_NS)
        self._collect_reports(port)

    def _collect_reports(self, port: PortRunner) -> None:
        reports = port.reports()
        for packet, report in zip(self._in_flight, reports, strict=False):
            self.tally.report(report)
            for observer in self._observers:
                observer.on_report(packet, report)
        del self._in_flight[: len(reports)]
        for event in port.take_link_events():
            for observer in self._observers:
                observer.on_link_event(event.time_ns, event.text)
        if data := port.far_end():
            for observer in self._observers:
                observer.on_far_end_data(data)

    def _on_stall(self, time_ns: int, what: str) -> None:
        self._process_events.add(self._process_events.count + 1, time_ns, what)
        for observer in self._observers:
            observer.on_process_event(time_ns, what)

    def _interrupt(self, *_: object) -> None:
        """Note the interruption; while the port is being opened there is no loop that would check."""
        self._interrupted = True
        if self._opening:
            raise KeyboardInterrupt
