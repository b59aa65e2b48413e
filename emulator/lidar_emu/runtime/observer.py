"""Observers of a run: displays, recorders, counters."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from typing import TYPE_CHECKING, Literal

from lidar_emu.device.commands import DeviceTimeline
from lidar_emu.device.modes import firing
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, OutgoingPacket

if TYPE_CHECKING:
    from lidar_emu.runtime.change_queue import ReceivedCommand, ReceivedMessage
    from lidar_emu.scenario.faults import LinkFault, ScheduledFault
    from lidar_emu.session import Block

EventSource = Literal["process", "link", "truth"]
"""One of the run's two processes, the link, or the source of live truth."""


class Observer:
    """Callbacks of a run; each observer overrides the ones that it needs. They are called in the loop of the run."""

    def on_ready(self, port: str) -> None:
        """The port is open under this name: a host can open it."""

    def on_waiting(self, port: str, what: str) -> None:
        """The port is open under this name, and the run waits for `what`."""

    def on_opened(self, port: str, start: datetime) -> None:
        """The port is open under this name; scenario time 0 is at `start`, in UTC."""

    def on_flight_started(self, waited_ns: int) -> None:
        """The command that starts the flight was executed: times so far counted from power-up, `waited_ns` before
        scenario time 0."""

    def on_truth(self, datagram: bytes, time_ns: int, counted: bool) -> None:
        """A simulator's datagram arrived at this scenario time; it was accepted (`counted`) or refused."""

    def on_truth_used(self, shot: int, age_ns: int, truth_count: int) -> None:
        """A shot was computed from truth of this age, after so many accepted truths."""

    def on_command(self, command: ReceivedCommand, shot: int | None) -> None:
        """A command was executed or rejected; `shot` is the first that follows it, None if there is none."""

    def on_host_message(self, message: ReceivedMessage) -> None:
        """A message of the host that is no command arrived, valid or not."""

    def on_acknowledgement(self, payload: bytes, time_ns: int) -> None:
        """The device acknowledges a command that arrived at this scenario time; see `on_sent_between`."""

    def on_housekeeping(self, payload: bytes, time_ns: int) -> None:
        """The device has made housekeeping of this scenario time; see `on_sent_between`."""

    def on_sent_between(self, time_ns: int | None) -> None:
        """The next acknowledgement or housekeeping was sent at this scenario time; None: it was not."""

    def on_fault_injected(self, number: int, fault: ScheduledFault | LinkFault, shot: int) -> None:
        """A fault was injected in flight: its place in the list, its times in scenario time, the first shot with it."""

    def on_block_computed(self, block: Block) -> None:
        """Shots were computed and go to the port; a command may still change them."""

    def on_superseded(self, generation: int, from_shot: int) -> None:
        """From this shot on, packets of earlier generations are not sent, unless they have been already."""

    def on_block_sent(self, block: Block) -> None:
        """The delivery status of all these shots is known."""

    def on_report(self, packet: OutgoingPacket, report: DeliveryReport) -> None:
        """The delivery status of a packet is known."""

    def on_event(self, source: EventSource, time_ns: int, what: str) -> None:
        """An event, such as a process that stalls or a link that breaks; time from the start of the run."""

    def on_far_end_data(self, data: bytes) -> None:
        """Bytes arrived at the far end of the in-memory loopback."""


class AbortOnLate(Observer):
    """Ends the run at the first late shot."""

    def __init__(self, fail: Callable[[str], None]) -> None:
        self._fail = fail

    def on_report(self, packet: OutgoingPacket, report: DeliveryReport) -> None:  # noqa: ARG002
        if report.status is DeliveryStatus.LATE:
            late_ms = (report.woke_ns - report.due_ns) * 1e-6
            self._fail(f"shot {report.shot} was {late_ms:.3f} ms late, and timing.when_late is abort")


class PulseSchedule(Observer):
    """Says which shots have a pulse, at the start of the flight and whenever that changes.

    Args:
        device: device of the run.
        valid_ns: time of validity of shot 0, scenario time.
        period_ns, shot_count: shots of the run.
        start_ns: instant of the monotonic clock at scenario time 0.
        send: takes the time of validity of shot 0, on the monotonic clock, the period, and what `firing` returns.
    """

    def __init__(
        self,
        device: DeviceTimeline,
        valid_ns: int,
        period_ns: int,
        shot_count: int,
        start_ns: Callable[[], int | None],
        send: Callable[[int, int, list[tuple[int, int]]], None],
    ) -> None:
        self._device, self._valid_ns, self._period_ns = device, valid_ns, period_ns
        self._shot_count, self._start_ns, self._send = shot_count, start_ns, send

    def on_opened(self, port: str, start: datetime) -> None:  # noqa: ARG002
        self._update(0)

    def on_command(self, command: ReceivedCommand, shot: int | None) -> None:  # noqa: ARG002
        if shot is not None:
            self._update(shot)

    def on_fault_injected(self, number: int, fault: ScheduledFault | LinkFault, shot: int) -> None:  # noqa: ARG002
        self._update(shot)

    def _update(self, shot: int) -> None:
        if (start_ns := self._start_ns()) is not None:  # before the flight nothing is fired
            device, period_ns = self._device, self._period_ns
            known = firing(device.constants, device.at(shot * period_ns), shot, period_ns)
            known = [each for each in known if each[0] < self._shot_count]
            self._send(start_ns + self._valid_ns, period_ns, [*known, (self._shot_count, 0)])
