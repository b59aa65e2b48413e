"""Events of a scenario whose time is known before the run: faults, changes of pattern, events of the device."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from lidar_emu.scenario.scanner import TimeSwitch
from lidar_emu.scenario.schema import BenchScenario, FlightScenario

_SHOWN = 3


class ScheduledEvent(NamedTuple):
    """An event at an instant of scenario time."""

    time_s: float
    what: str


def scheduled_events(scenario: FlightScenario | BenchScenario) -> list[ScheduledEvent]:
    """Events in ascending order of time; those at time 0 are left out."""
    return sorted(event for event in _events(scenario) if event.time_s > 0.0)


def next_events(events: list[ScheduledEvent], now_s: float) -> str:
    """The next events, each with the time that is left; empty after the last one."""
    coming = [event for event in events if event.time_s > now_s][:_SHOWN]
    return "; ".join(f"{event.what} in {event.time_s - now_s:.0f} s" for event in coming)


def _events(scenario: FlightScenario | BenchScenario) -> Iterator[ScheduledEvent]:
    for fault in scenario.faults:
        name = fault.kind.replace("_", " ")
        if fault.at_s is not None:
            yield ScheduledEvent(fault.at_s, name)
            continue
        yield ScheduledEvent(fault.from_s, f"{name} begins")
        if fault.to_s is not None:
            yield ScheduledEvent(fault.to_s, f"{name} ends")
    if scenario.device is not None:
        for event in scenario.device.events:
            yield ScheduledEvent(event.at_s, event.what.replace("_", " "))
    if isinstance(scenario, FlightScenario):
        for switch in scenario.scanner.switches:
            if isinstance(switch, TimeSwitch):
                yield ScheduledEvent(switch.at_s, "change of pattern")
