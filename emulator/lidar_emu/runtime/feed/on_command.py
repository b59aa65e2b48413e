"""A flight that waits for a command: until then the device boots, answers and tells how it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from lidar_emu.device.modes import initial
from lidar_emu.device.rules import Rules
from lidar_emu.device.state import Mode
from lidar_emu.device.timeline import DeviceTimeline
from lidar_emu.errors import InputError
from lidar_emu.runtime.device_link.housekeeping import HousekeepingSender
from lidar_emu.runtime.feed.base import POLL_NS, Desk, Feed

_LEAD_NS = 100_000_000
"""From the command to scenario time 0."""


def waiting_device(rules: Rules) -> DeviceTimeline:
    """The device before the flight: times count from power-up, and nothing happens to it that the scenario dates."""
    start = Mode.STANDBY if rules.start is Mode.TRACK else rules.start
    before = replace(rules, start=start, power_on_ns=0, events=())
    return DeviceTimeline(before, initial(before))


class OnCommandFeed:
    """Scenario time 0 comes soon after the command that makes the device acquire.

    Args:
        device: see `waiting_device`.
        flight: given scenario time 0 on the monotonic clock, the feed of the shots from there on.
        begun: told how long after power-up scenario time 0 comes.

    Raises:
        InputError: no command can be heard on this link.
    """

    def __init__(
        self,
        desk: Desk,
        device: DeviceTimeline,
        housekeeper: HousekeepingSender | None,
        flight: Callable[[int], Feed],
        begun: Callable[[int], None],
    ) -> None:
        if desk.commands is None:
            allowed = "allowed with an interface that has commands on this link"
            raise InputError("--start", None, "on-command", allowed)
        self._desk = desk
        self._device = device
        self._housekeeper = housekeeper
        self._flight, self._begun = flight, begun

    def fly(self) -> None:
        """See `Feed`."""
        powered_ns = self._desk.clock.now_ns()
        if not self._wait_for_command(powered_ns):
            return
        start_ns = self._desk.clock.now_ns() + _LEAD_NS
        state = self._device.start_flight(self._desk.session.rules, start_ns - powered_ns)
        if self._housekeeper is not None:
            self._housekeeper.start_flight()
        self._desk.session.use_device(state)
        self._begun(start_ns - powered_ns)
        self._flight(start_ns).fly()

    def _wait_for_command(self, powered_ns: int) -> bool:
        """Whether it came; False if the run was interrupted."""
        desk = self._desk
        while not desk.interrupted():
            now_ns = desk.clock.now_ns() - powered_ns
            desk.hear(now_ns, powered_ns)
            while desk.changes.first is not None:
                desk.follow(None)
            if self._device.at(now_ns).measures:
                return True
            if self._housekeeper is not None:
                self._housekeeper.tick(now_ns)
            desk.outbox.wait(desk.clock.now_ns() + POLL_NS)
            desk.outbox.settle()
        return False
