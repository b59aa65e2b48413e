"""A flight that waits for its host: it begins once the other end has opened the port."""

from __future__ import annotations

from lidar_emu.runtime.change_queue import ChangeQueue
from lidar_emu.runtime.feed.base import Feed, RunControl
from lidar_emu.runtime.feed.packet_queue import PacketQueue
from lidar_emu.runtime.host_wait import wait_for_host
from lidar_emu.session import Session


class OnConnectFeed(Feed):
    """Scenario time 0 follows the opening of the port by the other end.

    Args:
        control, session, packets, changes: see `Feed`.
        flight: the feed of the shots.
    """

    def __init__(
        self,
        control: RunControl,
        session: Session,
        packets: PacketQueue,
        changes: ChangeQueue,
        flight: Feed,
    ) -> None:
        super().__init__(control, session, packets, changes)
        self._flight = flight

    def run(self) -> None:
        """See `Feed`."""
        if wait_for_host(self._port, self._clock, self._may_wait):
            self._flight.run()

    def _may_wait(self) -> bool:
        """Meanwhile answer commands and injected faults, which affect the flight from its first shot on."""
        self._changes.receive(0)
        return self._control.may_wait()
