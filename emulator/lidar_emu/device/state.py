"""The state of the device, as one value."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lidar_emu.scenario.device import DeviceBehaviour, DeviceClock
from lidar_emu.scenario.faults import DeviceFault, Fault
from lidar_emu.scenario.faults.packets import BrownOut, ClockError, Interlock

# Nothing depends on the temperature: housekeeping shows a device that warms up.
AMBIENT_C, RISE_K, TIME_CONSTANT_S = 20.0, 12.0, 240.0


class ThermalState(NamedTuple):
    """The excess over the ambient temperature when the laser was switched last, and whether it was switched on."""

    since_ns: int
    excess_k: float
    laser_on: bool

    def temperature_c(self, time_ns: int) -> float:
        """Temperature at a time from `since_ns` on; before, the temperature at `since_ns`."""
        return AMBIENT_C + self._excess_k(time_ns)

    def switched(self, laser_on: bool, time_ns: int) -> ThermalState:
        """The state after the laser was switched on or off."""
        if laser_on == self.laser_on:
            return self
        return ThermalState(time_ns, self._excess_k(time_ns), laser_on)

    def _excess_k(self, time_ns: int) -> float:
        final_k = RISE_K if self.laser_on else 0.0
        elapsed_s = max(0, time_ns - self.since_ns) * 1e-9
        return final_k + (self.excess_k - final_k) * math.exp(-elapsed_s / TIME_CONSTANT_S)


LAST_NS = 2**32 * 10**9 - 30
"""The last time of the CCSDS time code, 4 + 3 bytes, to the nearest step."""

_NS_PER_S = 10**9
_Time = TypeVar("_Time", int, NDArray[np.int64])


class ReadingError(NamedTuple):
    """What a fault adds to the readings of a clock."""

    from_ns: int
    """True time at which the fault begins."""
    offset_ns: int
    rate_error: float
    """Growth of the error from there, as a fraction of true time."""
    second_half: bool
    """Whether it acts only in the second half of each second that the clock reads."""

    def at(self, time_ns: _Time, read_ns: _Time) -> _Time:
        """Error at a true time, at which the clock would read `read_ns`."""
        error_ns: _Time = self.offset_ns + _gained_ns(time_ns - self.from_ns, self.rate_error)
        late = read_ns % _NS_PER_S >= _NS_PER_S // 2
        return error_ns * late if self.second_half else error_ns


class OnboardClock(NamedTuple):
    """A clock that was set once, with a frequency error.

    True times are scenario times in nanoseconds, readings are nanoseconds since the clock's epoch.
    """

    epoch_ns: int
    """True time at which a clock without error reads 0."""
    rate_error: float
    """Fractional frequency error; positive: too fast."""
    set_ns: int
    """True time at which the clock was set."""
    shown_ns: int
    """Reading at that time."""
    synced_ns: int | None
    """True time of the last synchronisation; None: not locked."""
    locks_ns: int | None = None
    """True time of the first synchronisation, if that is still to come."""
    errors: tuple[ReadingError, ...] = ()
    """Errors by faults."""

    @property
    def is_exact(self) -> bool:
        """Whether the clock always reads scenario time."""
        return self.set_ns == self.shown_ns and self.rate_error == 0.0 and not self.errors

    def reads_ns(self, time_ns: _Time) -> _Time:
        """Reading at a true time. The counter stops at its ends: 0, and 2**32 s."""
        elapsed_ns = time_ns - self.set_ns
        read_ns: _Time = self.shown_ns + elapsed_ns + _gained_ns(elapsed_ns, self.rate_error)
        for error in self.errors:
            read_ns = read_ns + error.at(time_ns, read_ns)
        return min(max(0, read_ns), LAST_NS) if isinstance(read_ns, int) else np.clip(read_ns, 0, LAST_NS)

    def set_to(self, shown_ns: int, at_ns: int) -> OnboardClock:
        """The clock after synchronisation: at the true time `at_ns` it reads `shown_ns`; its frequency error and faults
        are unchanged."""
        return self._replace(set_ns=at_ns, shown_ns=shown_ns, synced_ns=at_ns, locks_ns=None)

    def counted_from(self, zero_ns: int) -> OnboardClock:
        """The same clock, with true times counted from another instant."""
        return self._replace(
            epoch_ns=self.epoch_ns - zero_ns,
            set_ns=self.set_ns - zero_ns,
            synced_ns=None if self.synced_ns is None else self.synced_ns - zero_ns,
            locks_ns=None if self.locks_ns is None else self.locks_ns - zero_ns,
            errors=tuple(error._replace(from_ns=error.from_ns - zero_ns) for error in self.errors),
        )


def _gained_ns(elapsed_ns: _Time, rate_error: float) -> _Time:
    if isinstance(elapsed_ns, int):
        return round(elapsed_ns * rate_error)
    gained_ns: NDArray[np.int64] = np.rint(elapsed_ns * rate_error).astype(np.int64)
    return gained_ns


def powered_up(part: DeviceClock, time_ns: int, epoch_ns: int = 0) -> OnboardClock:
    """The clock at power-up.

    Args:
        time_ns: true time of power-up.
        epoch_ns: true time at which a clock without offset reads 0.
    """
    return OnboardClock(
        epoch_ns=epoch_ns,
        rate_error=part.drift_ppm * 1e-6,
        set_ns=time_ns,
        shown_ns=time_ns - epoch_ns + round(part.offset_s * 1e9),
        synced_ns=time_ns if part.lock_s is None and part.source is None else None,
        locks_ns=None if part.lock_s is None or part.source else time_ns + _ns(part.lock_s),
    )


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


_BEGINS_AND_ENDS: dict[type, tuple[str, str]] = {
    BrownOut: ("power_off", "power_on"),
    Interlock: ("interlock_opens", "interlock_closes"),
    ClockError: ("clock_errs", "clock_recovers"),
}


@dataclass(frozen=True)
class TimedEvent:
    """An event of power supply, interlock or clock."""

    at_ns: int
    what: str
    """`power_off`, `power_on`, `interlock_opens`, `interlock_closes`, `clock_errs` or `clock_recovers`."""
    error: ReadingError | None = None
    """Error of the clock that begins or ends."""


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
        holdover_ns=None if clock.holdover_s is None or clock.source else _ns(clock.holdover_s),
        events=events_of(faults),
        rate_hz=rate_hz,
        beam_count=beam_count,
        pattern_count=pattern_count,
        laser_power_w=laser_power_w,
    )


def events_of(faults: Sequence[Fault]) -> tuple[TimedEvent, ...]:
    """Events of power supply, interlock and clock by faults, in ascending order."""
    events = []
    for fault in faults:
        if isinstance(fault, DeviceFault):
            (begins, ends), error = _BEGINS_AND_ENDS[type(fault)], None
            if isinstance(fault, ClockError):
                offset_ns, rate_error = _ns(fault.offset_s), fault.drift_ppm * 1e-6
                error = ReadingError(_ns(fault.from_s), offset_ns, rate_error, fault.second_half)
            events.append(TimedEvent(_ns(fault.from_s), begins, error))
            if fault.to_s is not None:
                events.append(TimedEvent(_ns(fault.to_s), ends, error))
    return tuple(sorted(events, key=lambda event: event.at_ns))


def _ns(time_s: float) -> int:
    return round(time_s * 1e9)
