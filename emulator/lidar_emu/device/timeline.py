"""State of the device over time by the commands so far, for the link between the shots."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import NamedTuple

from lidar_emu.device.commands import DeviceCommand, execute
from lidar_emu.device.constants import DeviceConstants, TimedEvent
from lidar_emu.device.modes import advance, counted_from, timed
from lidar_emu.device.state import DeviceState

_STORED = 256


class _Since(NamedTuple):
    from_ns: int
    state: DeviceState


class DeviceTimeline:
    """State from each command on. It depends on time and commands alone, never on measurements."""

    def __init__(self, constants: DeviceConstants, state: DeviceState) -> None:
        self.constants = constants
        self._first = state
        self._since: deque[_Since] = deque(maxlen=_STORED)

    def at(self, time_ns: int) -> DeviceState:
        """State at a scenario time, without later commands."""
        for from_ns, state in reversed(self._since):
            if from_ns <= time_ns:
                return advance(self.constants, state, time_ns)
        return advance(self.constants, self._first, time_ns)

    def execute(self, command: DeviceCommand) -> tuple[DeviceState | None, str]:
        """Execute a command; commands must be in order of time.

        Returns:
            The state after it, None if nothing changes; and its verdict.
        """
        before = self.at(command.time_ns)
        after, verdict = execute(self.constants, before, command)
        if after is before:
            return None, verdict
        self._since.append(_Since(command.time_ns, after))
        return after, verdict

    def use_events(self, events: tuple[TimedEvent, ...]) -> None:
        """Replace the events of the device; events up to now must be the same as before."""
        self.constants = replace(self.constants, events=events)
        self._first = timed(self.constants, self._first)
        since = [each._replace(state=timed(self.constants, each.state)) for each in self._since]
        self._since = deque(since, maxlen=_STORED)

    def start_flight(self, constants: DeviceConstants, zero_ns: int) -> DeviceState:
        """Count times from what was `zero_ns`, and use these constants from now on; returns the state then."""
        self.constants, self._first = constants, counted_from(constants, self.at(zero_ns), zero_ns)
        self._since.clear()
        return self._first
