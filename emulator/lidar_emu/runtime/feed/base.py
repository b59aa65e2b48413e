"""Base class of all feeds: passes packets to the port, and changes to the session."""

from __future__ import annotations

from abc import ABC, abstractmethod

from lidar_emu.runtime.change_queue import ChangeQueue
from lidar_emu.runtime.feed.packet_queue import PacketQueue
from lidar_emu.runtime.port.packets import DeliveryReport, OutgoingPacket
from lidar_emu.runtime.run_status import RunStatus
from lidar_emu.session import Session

POLL_NS = 20_000_000
"""Longest time until an interruption takes effect."""


class Feed(ABC):
    """Where the shots of a run come from.

    Args:
        status: beginning and end of the run.
        session: computes the shots.
        packets: packets on their way through the port.
        changes: commands and injected faults to apply to upcoming shots.
    """

    def __init__(
        self, status: RunStatus, session: Session, packets: PacketQueue, changes: ChangeQueue
    ) -> None:
        self._status, self._clock = status, status.clock
        self._session, self._changes = session, changes
        self._packets, self._port = packets, packets.port

    @abstractmethod
    def run(self) -> None:
        """Feed the port until the end of the flight, or until the run is stopped."""

    def _push(self, packet: OutgoingPacket) -> None:
        """Hand a packet over, waiting for room, unless the run is stopped meanwhile."""
        while not self._packets.push(packet):
            self._wait_for_reports()
            if self._status.stopped:
                return

    def _wait_for_reports(self) -> list[DeliveryReport]:
        """Wait a little for the port, and collect its reports."""
        self._port.wait(self._clock.now_ns() + POLL_NS)
        return self._packets.collect_reports()

    def _finish(self) -> None:
        """Announce that no more packets will follow, and wait until the port has completed them."""
        if not self._status.stopped:
            self._port.end_packets()
        while not (self._port.finished or self._status.stopped):
            self._wait_for_reports()
