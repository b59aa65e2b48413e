"""Events of a scenario whose time is known or estimated before the run: faults, changes of pattern, of the device."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from lidar_emu.scenario.scanner import AltitudeSwitch, TimeSwitch
from lidar_emu.scenario.schema import BenchScenario, FlightScenario

if TYPE_CHECKING:
    from lidar_emu.trajectory.profile import Trajectory

_SHOWN = 3
_SAMPLES = 2000


class ScheduledEvent(NamedTuple):
    """An event at an instant of scenario time."""

    time_s: float
    what: str


def scheduled_events(
    scenario: FlightScenario | BenchScenario, trajectory: Trajectory | None
) -> list[ScheduledEvent]:
    """Events in ascending order of time; events at time 0 are left out.

    A change of pattern at an altitude is estimated by the vehicle's altitude above the origin of the site frame.

    Args:
        trajectory: its trajectory; None if it has none. Changes at an altitude of a live one are left out.
    """
    events = [*_timed_events(scenario), *_altitude_switches(scenario, trajectory)]
    return sorted(event for event in events if event.time_s > 0.0)


def next_events(events: list[ScheduledEvent], now_s: float) -> str:
    """The next events, each with the time that is left; empty after the last one."""
    coming = [event for event in events if event.time_s > now_s][:_SHOWN]
    return "; ".join(f"{event.what} in {event.time_s - now_s:.0f} s" for event in coming)


def _timed_events(scenario: FlightScenario | BenchScenario) -> Iterator[ScheduledEvent]:
    for fault in scenario.faults:
        name = fault.kind.replace("_", " ")
        if fault.at_s is not None:
            yield ScheduledEvent(fault.at_s, name)
            continue
        yield ScheduledEvent(fault.from_s, f"{name} begins")
        if fault.to_s is not None:
            yield ScheduledEvent(fault.to_s, f"{name} ends")
    if isinstance(scenario, FlightScenario):
        for switch in scenario.scanner.switches:
            if isinstance(switch, TimeSwitch):
                yield ScheduledEvent(switch.at_s, "change of pattern")


def _altitude_switches(
    scenario: FlightScenario | BenchScenario, trajectory: Trajectory | None
) -> Iterator[ScheduledEvent]:
    if trajectory is None or scenario.live or not isinstance(scenario, FlightScenario):
        return
    switches = [switch for switch in scenario.scanner.switches if isinstance(switch, AltitudeSwitch)]
    if switches:
        time_s = np.linspace(0.0, trajectory.duration_s, _SAMPLES)
        altitude_m = trajectory.state(time_s).position_site_m[:, 2]
        for switch in switches:
            below = altitude_m < switch.below_m
            if below.any():
                what = f"change of pattern below {switch.below_m:g} m"
                yield ScheduledEvent(float(time_s[below.argmax()]), what)
