"""Constants of a device: its part of the scenario in integer nanoseconds, and values that it needs of other parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lidar_emu.device.state import Mode, Settings
from lidar_emu.scenario.device import DeviceBehaviour, DeviceClock
from lidar_emu.scenario.faults import DeviceFault, Fault
from lidar_emu.scenario.faults.device import BrownOut, Interlock

_BEGINS_AND_ENDS: dict[type, tuple[str, str]] = {
    BrownOut: ("power_off", "power_on"),
    Interlock: ("interlock_opens", "interlock_closes"),
}


@dataclass(frozen=True)
class TimedEvent:
    """An event of power supply or interlock."""

    at_ns: int
    what: str
    """`power_off`, `power_on`, `interlock_opens` or `interlock_closes`."""


@dataclass(frozen=True)
class DeviceConstants:
    """Constants that determine all changes of state."""

    start: Mode
    boot_ns: int
    self_test_ns: int
    warm_restart_ns: int
    waits_for_commands: bool
    """Whether the device stays in standby after a start; otherwise it begins to measure."""
    defaults: Settings
    """Settings after power-up and a cold restart."""
    clock: DeviceClock
    holdover_ns: int | None
    events: tuple[TimedEvent, ...]
    rate_hz: float
    """Rate of the scenario's shots."""
    beam_count: int
    pattern_count: int
    """Number of beam patterns that a command can select."""
    laser_power_w: float | None
    """Optical power while the laser is on; None: unknown."""


def device_constants(
    part: DeviceBehaviour,
    rate_hz: float,
    beam_count: int,
    pattern_count: int,
    laser_power_w: float | None = None,
    faults: Sequence[Fault] = (),
) -> DeviceConstants:
    """Constants of a scenario's device."""
    clock = part.clock
    return DeviceConstants(
        start=Mode(part.start),
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
        holdover_ns=None if clock.holdover_s is None else _ns(clock.holdover_s),
        events=events_of(faults),
        rate_hz=rate_hz,
        beam_count=beam_count,
        pattern_count=pattern_count,
        laser_power_w=laser_power_w,
    )


def events_of(faults: Sequence[Fault]) -> tuple[TimedEvent, ...]:
    """Events of power supply and interlock by faults, in ascending order."""
    events = []
    for fault in faults:
        if isinstance(fault, DeviceFault):
            begins, ends = _BEGINS_AND_ENDS[type(fault)]
            events.append(TimedEvent(_ns(fault.from_s), begins))
            if fault.to_s is not None:
                events.append(TimedEvent(_ns(fault.to_s), ends))
    return tuple(sorted(events, key=lambda event: event.at_ns))


def _ns(time_s: float) -> int:
    return round(time_s * 1e9)
