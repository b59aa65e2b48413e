"""The state of the device, as one value."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from lidar_emu.device.clock import OnboardClock
from lidar_emu.device.thermal import ThermalState


class Mode(StrEnum):
    """Modes, with the names of the interface; it has none for `off` and `boot`, in which nothing is sent."""

    OFF = "off"
    BOOT = "boot"
    SELF_TEST = "self_test"
    STANDBY = "standby"
    ACQUIRE = "acquire"
    TRACK = "track"
    FAULT = "fault"
    SAFE = "safe"


MEASURING = frozenset({Mode.ACQUIRE, Mode.TRACK})
"""Modes with laser on and measurements sent."""
SILENT = frozenset({Mode.OFF, Mode.BOOT})
"""Modes in which nothing is sent and commands are ignored."""
INTERLOCKED = frozenset({Mode.SELF_TEST, Mode.STANDBY, *MEASURING})
"""Modes from which an open interlock leads to mode fault."""


class Settings(NamedTuple):
    """Settings that commands change; a warm restart keeps them."""

    beams: int
    """Bit k: beam k fires."""
    housekeeping_rate_hz: float
    settling_ns: int
    """Settling time after a change of pattern, during which the beams do not fire."""
    acquisition_ns: int
    """Time from mode acquire to mode track."""
    pattern: int | None = None
    """Beam pattern; None: chosen by the scanner's own switches."""
    divisor: int = 1
    """Every `divisor`-th shot of the scenario is fired."""


class Status(NamedTuple):
    """Device status in the measurement packets."""

    mode: Mode
    laser_on: bool
    clock_locked: bool
    silent: bool = False
    """Whether the device sends no measurements although shots are due."""


TRACKING = Status(Mode.TRACK, laser_on=True, clock_locked=True)


class PendingTransition(NamedTuple):
    """A transition without a command."""

    at_ns: int
    mode: Mode


class DeviceState(NamedTuple):
    """The complete state of the device, without its measurements. Times are scenario times."""

    mode: Mode
    pending: tuple[PendingTransition, ...]
    """Transitions that follow without a command."""
    settings: Settings
    clock: OnboardClock
    thermal: ThermalState
    interlock_closed: bool
    restarted_ns: int
    """Time of the last power-up or restart."""
    restarts: int
    events_passed: int
    """Number of the scenario's events that have occurred."""
    until_ns: int | None
    """Next instant of a change without a command; None: never."""

    @property
    def measures(self) -> bool:
        """Whether the laser is on, and measurements are sent."""
        return self.mode in MEASURING

    @property
    def answers(self) -> bool:
        """Whether the device executes commands and sends housekeeping."""
        return self.mode not in SILENT

    @property
    def clock_locked(self) -> bool:
        """Whether the clock was synchronised within the holdover time."""
        return self.clock.synced_ns is not None
