"""What the device is doing, as one value."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from lidar_emu.device.clock import Clock
from lidar_emu.device.thermal import Heat


class Mode(StrEnum):
    """Modes, in the words of the interface; `boot` has none there, for nothing is sent in it."""

    OFF = "off"
    BOOT = "boot"
    SELF_TEST = "self_test"
    STANDBY = "standby"
    ACQUIRE = "acquire"
    TRACK = "track"
    FAULT = "fault"
    SAFE = "safe"


MEASURING = frozenset({Mode.ACQUIRE, Mode.TRACK})
"""Where the laser is on, and measurements are sent."""
DUMB = frozenset({Mode.OFF, Mode.BOOT})
"""Where nothing is sent and nothing is heard."""
GUARDED = frozenset({Mode.SELF_TEST, Mode.STANDBY, *MEASURING})
"""Which an open interlock turns into a fault."""


class Settings(NamedTuple):
    """What commands have set; a warm restart keeps it."""

    beams: int
    """Bit k: beam k fires."""
    housekeeping_rate_hz: float
    settling_ns: int
    """For so long after a change of pattern the beams do not fire."""
    acquisition_ns: int
    """From mode acquire to mode track."""
    pattern: int | None = None
    """The set of beams; None: as the scanner's own switches say."""
    divisor: int = 1
    """Every so manieth of the scenario's shots is fired."""


class Status(NamedTuple):
    """What packets say of the device besides the measurement."""

    mode: Mode
    laser_on: bool
    clock_locked: bool
    silent: bool = False
    """It sends no measurements, but shots are due all the same."""


TRACKING = Status(Mode.TRACK, laser_on=True, clock_locked=True)


class Due(NamedTuple):
    """A mode to come by itself."""

    at_ns: int
    mode: Mode


class DeviceState(NamedTuple):
    """Everything about the device but what it measures. Times are scenario times."""

    mode: Mode
    agenda: tuple[Due, ...]
    """The modes that follow by themselves."""
    settings: Settings
    clock: Clock
    heat: Heat
    interlock_closed: bool
    restarted_ns: int
    """When it was powered up or restarted last."""
    restarts: int
    events_passed: int
    """How many of the scenario's events have happened."""
    until_ns: int | None
    """The next instant at which it changes by itself; None: never."""

    @property
    def measures(self) -> bool:
        """Whether the laser is on, and measurements are sent."""
        return self.mode in MEASURING

    @property
    def answers(self) -> bool:
        """Whether commands are heard and housekeeping is sent."""
        return self.mode not in DUMB

    @property
    def clock_locked(self) -> bool:
        """Whether the clock was set right not too long ago."""
        return self.clock.synced_ns is not None
