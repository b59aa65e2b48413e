"""A flight that waits for a command: until then the device boots, acknowledges commands and sends housekeeping."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from lidar_emu.device.constants import DeviceConstants
from lidar_emu.device.modes import initial
from lidar_emu.device.state import Mode
from lidar_emu.device.timeline import DeviceTimeline
from lidar_emu.runtime.change_queue import ChangeQueue
from lidar_emu.runtime.device_link.housekeeping import HousekeepingSender
from lidar_emu.runtime.feed.base import Feed, RunControl
from lidar_emu.runtime.feed.packet_queue import PacketQueue
from lidar_emu.session import Session

_LEAD_NS = 100_000_000
"""From the command to scenario time 0."""


def waiting_device(constants: DeviceConstants) -> DeviceTimeline:
    """The device before the flight: times count from power-up, and the scenario's timed events are left out."""
    start = Mode.STANDBY if constants.start is Mode.TRACK else constants.start
    before = replace(constants, start=start, events=())
    return DeviceTimeline(before, initial(before))


class OnCommandFeed(Feed):
    """Scenario time 0 follows the command that makes the device acquire.

    Args:
        control, session, packets, changes: see `Feed`.
        device: see `waiting_device`.
        housekeeping: sends housekeeping; None: the interface has none.
        flight: makes the feed of the shots, from scenario time 0 on the monotonic clock.
        on_flight_started: called with the time from power-up to scenario time 0.
    """

    def __init__(
        self,
        control: RunControl,
        session: Session,
        packets: PacketQueue,
        changes: ChangeQueue,
        device: DeviceTimeline,
        housekeeping: HousekeepingSender | None,
        flight: Callable[[int], Feed],
        on_flight_started: Callable[[int], None],
    ) -> None:
        super().__init__(control, session, packets, changes)
        self._device, self._housekeeping = device, housekeeping
        self._flight, self._on_flight_started = flight, on_flight_started

    def run(self) -> None:
        """See `Feed`."""
        powered_ns = self._clock.now_ns()
        if not self._wait_for_command(powered_ns):
            return
        start_ns = self._clock.now_ns() + _LEAD_NS
        state = self._device.start_flight(self._session.constants, start_ns - powered_ns)
        if self._housekeeping is not None:
            self._housekeeping.start_flight()
        self._session.use_device(state)
        self._on_flight_started(start_ns - powered_ns)
        self._flight(start_ns).run()

    def _wait_for_command(self, powered_ns: int) -> bool:
        """Wait for the command; False if the run was stopped."""
        while self._control.may_wait():
            now_ns = self._clock.now_ns() - powered_ns
            self._changes.receive(now_ns, powered_ns)
            while self._changes.first is not None:
                self._changes.apply_first(self._session, None)
            if self._device.at(now_ns).measures:
                return True
            if self._housekeeping is not None:
                self._housekeeping.send_due(now_ns)
            self._wait_for_reports()
        return False
