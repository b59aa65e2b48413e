"""The device around the lidar: modes and their times, housekeeping and clock."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from lidar_emu.scenario.section import Part, Positive, unusable

LONGEST_STEP_S = 3600.0
LARGEST_OFFSET_S = 1e9
MOST_HOUSEKEEPING_HZ = 10.0
LEAST_HOLDOVER_S = 4.0
"""Of the system clock: PTP updates it every second, and a second later that shows."""

Step = Annotated[float, Field(ge=0, le=LONGEST_STEP_S)]
OffsetS = Annotated[float, Field(ge=-LARGEST_OFFSET_S, le=LARGEST_OFFSET_S)]
DriftPpm = Annotated[float, Field(ge=-1e4, le=1e4)]


class DeviceClock(Part):
    """The device's clock. The command `time_at_tone` sets it; it drifts from there."""

    source: Literal["system"] | None = None
    """`system`: the clock is the host's system clock, counted from `timing.epoch`, and locked while NTP or PTP keeps
    that. Left out: scenario time, until `time_at_tone`. For a flight computer that gets the same time by PTP."""
    offset_s: OffsetS = 0.0
    """Error at power-up: reading minus true time (for a time that is wrong until `time_at_tone`)."""
    drift_ppm: DriftPpm = 0.0
    """Rate error; positive if the clock is fast (for a quartz that is off between synchronisations)."""
    holdover_s: Positive | None = None
    """Time after power-up or the last synchronisation at which the lock is lost. Left out: never. For a flight
    computer that must notice a lost PPS."""
    lock_s: Step | None = None
    """Time from power-up or a cold restart to the first synchronisation: until then the clock is not locked, and wrong
    by `offset_s`. Left out: locked at once, with `offset_s`. For a sensor whose clock takes a minute to lock."""
    pulse_line: str | None = None
    """Modem line of the serial port (`cd`, `cts`, `dsr`) or PPS device of the system (such as `/dev/pps0`) whose rising
    edges are the pulses that `time_at_tone` speaks of. Left out: the arrival of the command counts. For a bench with a
    PPS wire."""
    pulse_out: Literal["rts", "dtr"] | None = None
    """Modem line of the serial port on which a pulse begins at the time of validity of each shot. Left out: none. For a
    flight computer, or a logic analyser, that relates the time stamps to its own clock."""

    def _check(self) -> None:
        line = self.pulse_line
        if not (line is None or line in ("cd", "cts", "dsr") or line.startswith("/dev/")):
            raise unusable("pulse_line", line, "cd, cts, dsr, or a PPS device such as /dev/pps0")
        if self.source is None:
            return
        for key in ("offset_s", "drift_ppm", "pulse_line"):
            if getattr(self, key):
                raise unusable(key, getattr(self, key), "left out beside source: system")
        if self.holdover_s is not None and self.holdover_s < LEAST_HOLDOVER_S:
            raise unusable(
                "holdover_s", self.holdover_s, f"at least {LEAST_HOLDOVER_S:g} beside source: system"
            )


class DeviceBehaviour(Part):
    """Modes, commands, housekeeping and clock; see docs/device.md."""

    start: Literal["track", "standby", "boot"] = "track"
    """State at power-up: `track` measures from the first shot; `standby` waits for a command; `boot` boots, runs the
    self-test and continues as `after_boot` states."""
    after_boot: Literal["standby", "track"] = "standby"
    """After boot: wait in `standby` for a command, or acquire and track at once, as a device without telecommands
    does."""
    boot_s: Step = 2.0
    """Time from power-up or a cold restart to the self-test (for a flight computer that times out while it waits)."""
    self_test_s: Step = 1.0
    """Time from the start of the self-test to `standby` (for a device whose self-test takes another time)."""
    warm_restart_s: Step = 0.5
    """Time from a warm restart to `standby` (for a recovery that must end before touchdown)."""
    acquisition_s: Step = 0.5
    """Time in mode `acquire` before mode `track` (for a detector that needs more shots to lock)."""
    settling_s: Step = 0.0
    """Beams do not fire in shots that begin within this time after a change of pattern (for a scanner that switches
    beams slowly)."""
    housekeeping_rate_hz: Annotated[float, Field(ge=0, le=MOST_HOUSEKEEPING_HZ)] = 1.0
    """Housekeeping packets per second, at multiples of their period in scenario time; 0: none."""
    clock: DeviceClock = DeviceClock()
    """The device's clock."""
