"""The device as those see it who talk to it while it works: its state at each time, by the commands so far."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import NamedTuple

from lidar_emu.device.commands import Order, obey
from lidar_emu.device.modes import advance, counted_from, timed
from lidar_emu.device.rules import Event, Rules
from lidar_emu.device.state import DeviceState

_REMEMBERED = 256


class _Since(NamedTuple):
    from_ns: int
    state: DeviceState


class DeviceTimeline:
    """The state from each command on. It depends on time and commands alone, never on what was measured."""

    def __init__(self, rules: Rules, state: DeviceState) -> None:
        self.rules = rules
        self._first = state
        self._since: deque[_Since] = deque(maxlen=_REMEMBERED)

    def at(self, time_ns: int) -> DeviceState:
        """The state at a scenario time, later commands aside."""
        for from_ns, state in reversed(self._since):
            if from_ns <= time_ns:
                return advance(self.rules, state, time_ns)
        return advance(self.rules, self._first, time_ns)

    def obey(self, order: Order) -> tuple[DeviceState | None, str]:
        """What a command makes of the device, None if nothing; and its verdict. Commands come in the order of time."""
        before = self.at(order.time_ns)
        after, verdict = obey(self.rules, before, order)
        if after is before:
            return None, verdict
        self._since.append(_Since(order.time_ns, after))
        return after, verdict

    def expect(self, events: tuple[Event, ...]) -> None:
        """From now on these will be done to it, instead of what was to be: the same until now, and others later."""
        self.rules = replace(self.rules, events=events)
        self._first = timed(self.rules, self._first)
        since = [each._replace(state=timed(self.rules, each.state)) for each in self._since]
        self._since = deque(since, maxlen=_REMEMBERED)

    def start_flight(self, rules: Rules, zero_ns: int) -> DeviceState:
        """From now on times count from what was `zero_ns`, and these rules hold; returns the state then."""
        self.rules, self._first = rules, counted_from(rules, self.at(zero_ns), zero_ns)
        self._since.clear()
        return self._first
