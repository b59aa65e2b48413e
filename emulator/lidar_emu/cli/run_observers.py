"""Observers that print a run: the port, a progress line, and what the loopback receives."""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import datetime

import click

from lidar_emu.cli.messages import Decoder, ShotPrinter
from lidar_emu.cli.summary_lines import at_time
from lidar_emu.cli.terminal import print_line
from lidar_emu.runtime.observer import EventSource, Observer
from lidar_emu.runtime.port.packets import DeliveryReport, OutgoingPacket
from lidar_emu.runtime.summary import Tally
from lidar_protocol import Interface

_SHOW_EVERY_S = 0.5


class Announcer(Observer):
    """Prints the port and its events."""

    def __init__(self, name: str, pace: str, print_line: Callable[[str], None] = print_line) -> None:
        self._name, self._pace = name, pace
        self._print_line = print_line

    def on_waiting(self, port: str, what: str) -> None:
        """Print the port, and the event that the run waits for."""
        self._print_line(f"{self._name} on {port}, pace {self._pace}, waits for {what}; Ctrl-C ends it")

    def on_opened(self, port: str, start: datetime) -> None:
        """Print the port and the start of the run."""
        self._print_line(
            f"{self._name} on {port}, pace {self._pace}, from {start:%Y-%m-%d %H:%M:%S} UTC; Ctrl-C ends it"
        )

    def on_event(self, source: EventSource, time_ns: int, what: str) -> None:
        """Print an event of a process or of truth; a flapping link has too many."""
        if source != "link":
            self._print_line(at_time(time_ns * 1e-9, what))


class ReadyLine(Observer):
    """Prints one line of JSON as soon as the port is open."""

    def on_ready(self, port: str) -> None:
        """Print the port."""
        print_line(json.dumps({"ready": {"port": port}}))


class ProgressLine(Observer):
    """A line on the terminal with the time and the counts of a run."""

    def __init__(self, tally: Tally) -> None:
        self._tally = tally
        self._next_ns = 0

    def on_report(self, packet: OutgoingPacket, report: DeliveryReport) -> None:  # noqa: ARG002
        """Show the counts twice a second."""
        if report.due_ns >= self._next_ns:
            self._next_ns = report.due_ns + round(_SHOW_EVERY_S * 1e9)
            sent, late, dropped = self._tally.sent, self._tally.late, self._tally.dropped
            line = f"\r{report.due_ns * 1e-9:9.1f} s: {sent} sent, {late} late, {dropped} dropped "
            click.echo(line, nl=False, err=True)


class LoopbackView(Observer):
    """The far end of the in-memory loopback: decodes all packets, prints two shots a second."""

    def __init__(self, interface: Interface, quiet: bool) -> None:
        self._decoder = Decoder(interface)
        self._printer = None if quiet else ShotPrinter(_SHOW_EVERY_S, interface)

    def on_far_end_data(self, data: bytes) -> None:
        """Decode the data and print the shots that are due."""
        messages = self._decoder.decode(data)
        if self._printer is not None:
            self._printer.show(messages)

    def counters(self) -> dict[str, int]:
        """The decoder's counters."""
        return self._decoder.counters()
