"""Whoever looks on while a scenario is flown."""

from __future__ import annotations

from datetime import datetime

from lidar_emu.runtime.device_link.received_command import ReceivedCommand
from lidar_emu.runtime.port.packets import Outgoing, Report
from lidar_emu.scenario.faults import LinkFault, ScheduledFault
from lidar_emu.session import Block


class Observer:
    """Displays and recorders: each overrides what concerns it."""

    def on_waiting(self, port: str, what: str) -> None:
        """The port is open under this name, and the run begins with something that is waited for."""

    def on_opened(self, port: str, start: datetime) -> None:
        """The port is open under this name; scenario time 0 will be, or was, at `start`, in UTC."""

    def on_flight_started(self, waited_ns: int) -> None:
        """The command to fly has come: times told so far counted from power-up, so long before scenario time 0."""

    def on_truth(self, datagram: bytes, time_ns: int, counted: bool) -> None:
        """A simulator's datagram arrived, at this scenario time; it counted or was refused."""

    def on_truth_used(self, shot: int, age_ns: int, truth_time_ns: int) -> None:
        """A shot was computed from truth that was so old then; the newest was of this scenario time."""

    def on_command(self, heard: ReceivedCommand, shot: int | None) -> None:
        """A command was answered; this shot is the first that follows it, None if none does."""

    def on_acknowledgement(self, payload: bytes, time_ns: int) -> None:
        """The device answered a command that came at this scenario time."""

    def on_housekeeping(self, payload: bytes, time_ns: int) -> None:
        """The device told how it was at this scenario time."""

    def on_fault_injected(self, number: int, fault: ScheduledFault | LinkFault, shot: int) -> None:
        """A fault was ordered in flight: its place in the list; its times, in scenario time; the first shot with it."""

    def on_block_computed(self, block: Block) -> None:
        """Shots are on their way to the port; a command may yet change them."""

    def on_superseded(self, generation: int, from_shot: int) -> None:
        """From this shot on, packets of earlier generations are not to be sent, unless they have been already."""

    def on_block_sent(self, block: Block) -> None:
        """The delivery status of all these shots is known."""

    def on_report(self, packet: Outgoing, report: Report) -> None:
        """The delivery status of a packet is known."""

    def on_process_event(self, time_ns: int, what: str) -> None:
        """One of the run's two processes stands still, stood still, or goes on; time from the start of the run."""

    def on_link_event(self, time_ns: int, what: str) -> None:
        """Something happened to the link; time from the start of the run."""

    def on_far_end_data(self, data: bytes) -> None:
        """Bytes at the far end of the in-memory loopback."""
