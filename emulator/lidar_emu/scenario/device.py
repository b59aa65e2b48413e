"""The device around the lidar: its modes and their times, its housekeeping, its clock, and what is done to it."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from lidar_emu.errors import Finding
from lidar_emu.scenario.part import NonNegative, Part, Positive, Switch, unusable

LONGEST_STEP_S = 3600.0
LARGEST_OFFSET_S = 1e9
MOST_HOUSEKEEPING_HZ = 10.0

Step = Annotated[float, Field(ge=0, le=LONGEST_STEP_S)]


class DeviceClock(Part):
    """What the device takes for the time. It is set by the command `time_at_tone`, and drifts on from there."""

    offset_s: Annotated[float, Field(ge=-LARGEST_OFFSET_S, le=LARGEST_OFFSET_S)] = 0.0
    """Reading less true time at power-up."""
    drift_ppm: Annotated[float, Field(ge=-1e4, le=1e4)] = 0.0
    """How much too fast it runs at power-up."""
    ageing_ppm_per_day: Annotated[float, Field(ge=-1e4, le=1e4)] = 0.0
    """How `drift_ppm` changes."""
    wander_ppm: Annotated[float, Field(ge=0, le=1e4)] = 0.0
    """Random wander of the rate over tens of seconds to hours, root mean square; added to the drift."""
    locked_at_start: Switch = True
    """Whether the lock flag is set at power-up; a synchronisation sets it in any case."""
    holdover_s: Positive | None = None
    """Time after power-up or the last synchronisation at which the lock is lost. Left out: never."""
    pulse_line: Literal["cd", "cts", "dsr"] | None = None
    """Modem line of the serial port whose rising edges are the pulses that `time_at_tone` speaks of. Left out: the
    arrival of the command counts."""


class Thermal(Part):
    """The temperature that housekeeping reports: it approaches `ambient_c + rise_k` while the laser is on."""

    ambient_c: Annotated[float, Field(ge=-273.15, le=300)] = 20.0
    """Temperature with the laser off for long, and at power-up."""
    rise_k: NonNegative = 12.0
    """Final temperature rise with the laser on."""
    time_constant_s: Positive = 240.0
    """Time constant of warming up and of cooling down."""
    limit_c: float | None = None
    """Above it the device goes to mode `fault`. Left out: no limit."""


class DeviceEvent(Part):
    """Something that is done to the device at an instant."""

    at_s: NonNegative
    """Scenario time."""
    what: Literal["interlock_opens", "interlock_closes", "power_off", "power_on"]
    """An open interlock puts the device into mode `fault`. After `power_on` it boots, as new."""


class DeviceBehaviour(Part):
    """Modes, commands, housekeeping and clock; see docs/device.md."""

    start: Literal["track", "standby", "boot"] = "track"
    """What the device does from power-up on: `track` measures from the first shot on; `boot` boots, tests itself and
    goes on as `after_boot` says."""
    after_boot: Literal["standby", "track"] = "standby"
    """After boot: wait in `standby` for a command, or acquire and track at once, as a device does that nobody
    commands."""
    power_on_s: NonNegative = 0.0
    """Scenario time of power-up; before it there is nothing on the wire."""
    boot_s: Step = 2.0
    """Time from power-up or a cold restart to the self-test."""
    self_test_s: Step = 1.0
    """Time from the start of the self-test to `standby`."""
    warm_restart_s: Step = 0.5
    """Time from a warm restart to `standby`."""
    acquisition_s: Step = 0.5
    """How long the device is in mode `acquire` before it is in `track`."""
    settling_s: Step = 0.0
    """Beams do not fire in shots that begin so soon after a change of pattern."""
    housekeeping_rate_hz: Annotated[float, Field(ge=0, le=MOST_HOUSEKEEPING_HZ)] = 1.0
    """Housekeeping packets per second, in whole scenario seconds and parts of them; 0: none."""
    clock: DeviceClock = DeviceClock()
    """The device's clock."""
    thermal: Thermal = Thermal()
    """Its temperature."""
    events: Annotated[list[DeviceEvent], Field(max_length=256)] = []
    """What is done to it, in ascending order of time."""

    @model_validator(mode="after")
    def _events_ascend(self) -> Self:
        times = [event.at_s for event in self.events]
        if times != sorted(times):
            raise unusable("events", Finding("instants out of order"), "events in ascending order of at_s")
        return self
