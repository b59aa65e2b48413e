"""The device around the lidar: modes and their times, housekeeping, clock and external events."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from lidar_emu.errors import Finding
from lidar_emu.scenario.section import NonNegative, Part, Positive, Switch, unusable

LONGEST_STEP_S = 3600.0
LARGEST_OFFSET_S = 1e9
MOST_HOUSEKEEPING_HZ = 10.0

Step = Annotated[float, Field(ge=0, le=LONGEST_STEP_S)]


class DeviceClock(Part):
    """The device's clock. The command `time_at_tone` sets it; it drifts from there."""

    offset_s: Annotated[float, Field(ge=-LARGEST_OFFSET_S, le=LARGEST_OFFSET_S)] = 0.0
    """Error at power-up: reading minus true time."""
    drift_ppm: Annotated[float, Field(ge=-1e4, le=1e4)] = 0.0
    """Rate error at power-up; positive if the clock is fast."""
    ageing_ppm_per_day: Annotated[float, Field(ge=-1e4, le=1e4)] = 0.0
    """Change of the rate error per day."""
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
    """Temperature at power-up, and in equilibrium with the laser off."""
    rise_k: NonNegative = 12.0
    """Final temperature rise with the laser on."""
    time_constant_s: Positive = 240.0
    """Time constant of warming up and of cooling down."""
    limit_c: float | None = None
    """Above it the device goes to mode `fault`. Left out: no limit."""


class DeviceEvent(Part):
    """An external event at an instant."""

    at_s: NonNegative
    """Scenario time."""
    what: Literal["interlock_opens", "interlock_closes", "power_off", "power_on"]
    """An open interlock puts the device into mode `fault`. After `power_on` the device boots with its initial state."""


class DeviceBehaviour(Part):
    """Modes, commands, housekeeping and clock; see docs/device.md."""

    start: Literal["track", "standby", "boot"] = "track"
    """State at power-up: `track` measures from the first shot; `standby` waits for a command; `boot` boots, runs the
    self-test and continues as `after_boot` states."""
    after_boot: Literal["standby", "track"] = "standby"
    """After boot: wait in `standby` for a command, or acquire and track at once, as a device without telecommands
    does."""
    power_on_s: NonNegative = 0.0
    """Scenario time of power-up; the device is silent before it."""
    boot_s: Step = 2.0
    """Time from power-up or a cold restart to the self-test."""
    self_test_s: Step = 1.0
    """Time from the start of the self-test to `standby`."""
    warm_restart_s: Step = 0.5
    """Time from a warm restart to `standby`."""
    acquisition_s: Step = 0.5
    """Time in mode `acquire` before mode `track`."""
    settling_s: Step = 0.0
    """Beams do not fire in shots that begin within this time after a change of pattern."""
    housekeeping_rate_hz: Annotated[float, Field(ge=0, le=MOST_HOUSEKEEPING_HZ)] = 1.0
    """Housekeeping packets per second, at multiples of their period in scenario time; 0: none."""
    clock: DeviceClock = DeviceClock()
    """The device's clock."""
    thermal: Thermal = Thermal()
    """Temperature model."""
    events: Annotated[list[DeviceEvent], Field(max_length=256)] = []
    """External events, in ascending order of time."""

    @model_validator(mode="after")
    def _events_ascend(self) -> Self:
        times = [event.at_s for event in self.events]
        if times != sorted(times):
            raise unusable("events", Finding("instants out of order"), "events in ascending order of at_s")
        return self
