"""How this device behaves: the scenario's part in whole nanoseconds, with what of the rest concerns it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lidar_emu.device.frequency_noise import Wander
from lidar_emu.device.state import Mode, Settings
from lidar_emu.device.thermal import Heating
from lidar_emu.scenario.device import DeviceBehaviour, DeviceClock
from lidar_emu.scenario.faults import BrownOut, DeviceFault, Fault, Interlock

_BEGINS_AND_ENDS: dict[type, tuple[str, str]] = {
    BrownOut: ("power_off", "power_on"),
    Interlock: ("interlock_opens", "interlock_closes"),
}


@dataclass(frozen=True)
class Event:
    """Something that is done to the device."""

    at_ns: int
    what: str
    """As in the scenario."""


@dataclass(frozen=True)
class Rules:
    """What changes of state follow from."""

    start: Mode
    power_on_ns: int
    boot_ns: int
    self_test_ns: int
    warm_restart_ns: int
    waits_for_commands: bool
    """Whether it stands by after a start, or goes on to measure by itself."""
    defaults: Settings
    """After power-up and a cold restart."""
    clock: DeviceClock
    wander: Wander | None
    """Of the clock."""
    holdover_ns: int | None
    heating: Heating
    events: tuple[Event, ...]
    rate_hz: float
    """Of the scenario's shots."""
    beam_count: int
    pattern_count: int
    """How many patterns a command can choose from."""
    laser_power_w: float | None
    """Of the laser while it is on; None: unknown."""


def device_rules(
    part: DeviceBehaviour,
    rate_hz: float,
    beam_count: int,
    pattern_count: int,
    laser_power_w: float | None = None,
    faults: Sequence[Fault] = (),
    seed: int = 0,
) -> Rules:
    """The rules of a scenario's device; `seed` is that of its clock's wander."""
    thermal, clock = part.thermal, part.clock
    return Rules(
        start=Mode(part.start),
        power_on_ns=_ns(part.power_on_s),
        boot_ns=_ns(part.boot_s),
        self_test_ns=_ns(part.self_test_s),
        warm_restart_ns=_ns(part.warm_restart_s),
        waits_for_commands=part.after_boot == "standby",
        defaults=Settings(
            beams=(1 << beam_count) - 1,
            housekeeping_rate_hz=part.housekeeping_rate_hz,
            settling_ns=_ns(part.settling_s),
            acquisition_ns=_ns(part.acquisition_s),
        ),
        clock=clock,
        wander=Wander.drawn(clock.wander_ppm * 1e-6, seed),
        holdover_ns=None if clock.holdover_s is None else _ns(clock.holdover_s),
        heating=Heating(thermal.ambient_c, thermal.rise_k, thermal.time_constant_s, thermal.limit_c),
        events=all_events(part, faults),
        rate_hz=rate_hz,
        beam_count=beam_count,
        pattern_count=pattern_count,
        laser_power_w=laser_power_w,
    )


def all_events(part: DeviceBehaviour, faults: Sequence[Fault]) -> tuple[Event, ...]:
    """What is done to a device by its scenario, faults included, in ascending order."""
    events = [Event(_ns(event.at_s), event.what) for event in part.events]
    for fault in faults:
        if isinstance(fault, DeviceFault):
            begins, ends = _BEGINS_AND_ENDS[type(fault)]
            events.append(Event(_ns(fault.from_s), begins))
            if fault.to_s is not None:
                events.append(Event(_ns(fault.to_s), ends))
    return tuple(sorted(events, key=lambda event: event.at_ns))


def _ns(time_s: float) -> int:
    return round(time_s * 1e9)
