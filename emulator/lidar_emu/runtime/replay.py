"""Replay: sends recorded packets again over a port, each when it is due."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any

from lidar_emu.errors import Finding, InputError
from lidar_emu.runtime.machine import Machine
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.options import StartEvent, default_start, wait_limit_s
from lidar_emu.runtime.port.child import PortDiedError
from lidar_emu.runtime.port.packets import OutgoingPacket, Pace, Pacing
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.runtime.run_status import POLL_NS, RunStatus, wait_for_host
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
        pace: by the clock, or as fast as the link takes them.
        load: share of the link's capacity that the packets take.
        observers: called in the loop: they must be quick.
        start: `NOW` or `ON_CONNECT`; None: the port's default.
        limit_s: limit of the wait for a host; None: a minute.
        machine: where it runs; None: the real one.

    Raises:
        InputError: the port does not show its host.
    """

    def __init__(
        self,
        packets: Iterable[OutgoingPacket],
        longest_bytes: int,
        port: PortSpec,
        pace: Pace,
        load: float,
        observers: Sequence[Observer],
        start: StartEvent | None = None,
        limit_s: float | None = None,
        machine: Machine | None = None,
    ) -> None:
        self._start = start or default_start(port)
        if self._start is StartEvent.ON_CONNECT and not port.shows_host:
            found = Finding(f"{port} does not show when a host opens it")
            raise InputError("--start", None, found, "use now")
        self._limit_s = wait_limit_s(self._start, limit_s)
        self._packets, self._longest_bytes = packets, longest_bytes
        self._spec, self._load = port, load
        self._observers = observers
        self._in_flight: list[OutgoingPacket] = []
        self._machine = machine or Machine()
        self._status = RunStatus(observers, Pacing(pace, LATE_AFTER_NS), self._machine.clock)
        self.tally = Tally(pace)

    def play(self) -> dict[str, Any]:
        """Send to the end, or until SIGINT, SIGTERM or SIGHUP; return the summary.

        Raises:
            InputError: the port cannot be opened.
            RunError: opening the port took too long. If its process dies, the replay ends with its summary.
        """
        status = self._status
        with (
            status.interruptible(),
            PortRunner(_SLOTS, self._longest_bytes, status.on_stall, machine=self._machine) as port,
        ):
            with suppress(KeyboardInterrupt):
                waits = self._start is StartEvent.ON_CONNECT
                try:
                    port.start(self._spec, may_be_absent=waits)
                    status.ready(port)
                    if waits:
                        status.wait_for("a host to open it", self._limit_s)
                    if not waits or wait_for_host(status, port):
                        self._send(port)
                except PortDiedError as death:
                    status.fail(str(death))
            port.close()
            self._collect_reports(port)
        shots = self.tally.to_json()["shots"]
        return {
            **status.to_json(self._spec, port.status, self._load),
            "packets": {name: shots[name] for name in ("due", "sent", "late", "dropped")},
            "lateness": self.tally.to_json()["lateness"],
        }

    def _send(self, port: PortRunner) -> None:
        self._status.begin(self._status.clock.now_ns() + _LEAD_NS)
        for packet in self._packets:
            while not (self._status.interrupted or port.push(packet)):
                self._wait_for_reports(port)
            if self._status.interrupted:
                return
            self._in_flight.append(packet)
            self._collect_reports(port)
        port.end_packets()
        while not (port.finished or self._status.interrupted):
            self._wait_for_reports(port)

    def _wait_for_reports(self, port: PortRunner) -> None:
        port.wait(self._status.clock.now_ns() + POLL_NS)
        self._collect_reports(port)

    def _collect_reports(self, port: PortRunner) -> None:
        reports = port.reports()
        for packet, report in zip(self._in_flight, reports, strict=False):
            self.tally.add_report(report)
            for observer in self._observers:
                observer.on_report(packet, report)
        del self._in_flight[: len(reports)]
        for event in port.take_link_events():
            for observer in self._observers:
                observer.on_event("link", event.time_ns, event.text)
        if data := port.far_end():
            for observer in self._observers:
                observer.on_far_end_data(data)
