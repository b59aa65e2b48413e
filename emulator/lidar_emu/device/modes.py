"""The device's modes: transitions by itself, and by power, interlock and restarts; which shots it fires in them.

    off --power--> boot --> self_test --> standby <--> acquire --> track
                    ^                        ^            |          |
    reset ----------+ (warm: no self-test)   +-- command -+----------+
                                     or, after a start, by itself
    open interlock: --> fault, left by reset         command: --> safe, left by command or reset

All functions here depend on the previous state and scenario time alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lidar_emu.device.state import (
    INTERLOCKED,
    MEASURING,
    DeviceConstants,
    DeviceState,
    Mode,
    PendingTransition,
    ReadingError,
    Status,
    ThermalState,
    TimedEvent,
    powered_up,
)
from lidar_emu.numerics.arrays import BoolArray, IntArray


def initial(constants: DeviceConstants) -> DeviceState:
    """The state at the beginning of the scenario: off, or the mode that the device starts in."""
    transitions: tuple[PendingTransition, ...] = (PendingTransition(0, constants.start),)
    if constants.start is Mode.BOOT:
        transitions = _cold_start(constants, 0)
    off = DeviceState(
        mode=Mode.OFF,
        pending=transitions,
        settings=constants.defaults,
        clock=powered_up(constants.clock, 0),
        thermal=ThermalState(0, 0.0, laser_on=False),
        interlock_closed=True,
        restarted_ns=0,
        restarts=0,
        events_passed=0,
        until_ns=None,
    )
    return advance(constants, timed(constants, off), 0)


def advance(constants: DeviceConstants, state: DeviceState, time_ns: int) -> DeviceState:
    """State at a time, if no command arrives until then; an earlier time changes nothing."""
    while state.until_ns is not None and state.until_ns <= time_ns:
        state = timed(constants, _next(constants, state, state.until_ns))
    return state


def timed(constants: DeviceConstants, state: DeviceState) -> DeviceState:
    """State with the instant of its next change; call it after any change that could have moved that instant."""
    synced_ns, holdover_ns = state.clock.synced_ns, constants.holdover_ns
    instants = (
        state.pending[0].at_ns if state.pending else None,
        _event_ns(constants, state),
        None if synced_ns is None or holdover_ns is None else synced_ns + holdover_ns,
        state.clock.locks_ns,
    )
    until_ns = min((instant for instant in instants if instant is not None), default=None)
    return state._replace(until_ns=until_ns)


def firing(
    constants: DeviceConstants, state: DeviceState, shot: int, period_ns: int
) -> list[tuple[int, int]]:
    """Which shots are measured from this one on, if no command arrives: first shot, and the divisor of the numbers that
    are measured from there, 0 for none.

    Args:
        state: state at the beginning of the shot.
        period_ns: from shot to shot.
    """
    found = [(shot, state.settings.divisor if state.measures else 0)]
    while state.until_ns is not None:
        shot = -(-state.until_ns // period_ns)
        state = advance(constants, state, shot * period_ns)
        found.append((shot, state.settings.divisor if state.measures else 0))
    return found


def enter(
    state: DeviceState,
    mode: Mode,
    time_ns: int,
    pending: tuple[PendingTransition, ...] = (),
) -> DeviceState:
    """State in another mode, with the transitions that follow; mode fault if the interlock is open."""
    if mode in INTERLOCKED and not state.interlock_closed:
        mode, pending = Mode.FAULT, ()
    thermal = state.thermal.switched(mode in MEASURING, time_ns)
    return state._replace(mode=mode, pending=pending, thermal=thermal)


def acquire(state: DeviceState, time_ns: int) -> DeviceState:
    """State in mode acquire, which mode track follows."""
    track = PendingTransition(time_ns + state.settings.acquisition_ns, Mode.TRACK)
    return enter(state, Mode.ACQUIRE, time_ns, (track,))


def restart(constants: DeviceConstants, state: DeviceState, time_ns: int, cold: bool) -> DeviceState:
    """State after a reset: boot, then standby; after a cold restart with self-test, and with settings and clock of
    power-up."""
    state = state._replace(restarts=state.restarts + 1, restarted_ns=time_ns)
    if not cold:
        started = _started(constants, time_ns + constants.warm_restart_ns, state.settings.acquisition_ns)
        return enter(state, Mode.BOOT, time_ns, started)
    clock = powered_up(constants.clock, time_ns, state.clock.epoch_ns)._replace(errors=state.clock.errors)
    boot, *rest = _cold_start(constants, time_ns)
    return enter(state._replace(settings=constants.defaults, clock=clock), boot.mode, time_ns, tuple(rest))


def counted_from(constants: DeviceConstants, state: DeviceState, zero_ns: int) -> DeviceState:
    """The same state with times counted from another instant, with constants whose events count from there."""
    moved = state._replace(
        pending=tuple(PendingTransition(due.at_ns - zero_ns, due.mode) for due in state.pending),
        clock=state.clock.counted_from(zero_ns),
        thermal=state.thermal._replace(since_ns=state.thermal.since_ns - zero_ns),
        restarted_ns=state.restarted_ns - zero_ns,
    )
    return timed(constants, moved)


def _cold_start(constants: DeviceConstants, time_ns: int) -> tuple[PendingTransition, ...]:
    self_test_ns = time_ns + constants.boot_ns
    started = _started(constants, self_test_ns + constants.self_test_ns, constants.defaults.acquisition_ns)
    return (PendingTransition(time_ns, Mode.BOOT), PendingTransition(self_test_ns, Mode.SELF_TEST), *started)


def _started(constants: DeviceConstants, time_ns: int, acquisition_ns: int) -> tuple[PendingTransition, ...]:
    if constants.waits_for_commands:
        return (PendingTransition(time_ns, Mode.STANDBY),)
    return PendingTransition(time_ns, Mode.ACQUIRE), PendingTransition(time_ns + acquisition_ns, Mode.TRACK)


def _next(constants: DeviceConstants, state: DeviceState, time_ns: int) -> DeviceState:
    """State after the change that is due at this instant; the order of the checks decides between several."""
    if _event_ns(constants, state) == time_ns:
        event = constants.events[state.events_passed]
        return _happened(constants, state._replace(events_passed=state.events_passed + 1), event)
    if state.pending and state.pending[0].at_ns == time_ns:
        due, *rest = state.pending
        return enter(state, due.mode, time_ns, tuple(rest))
    clock = state.clock
    if clock.locks_ns == time_ns:
        return state._replace(clock=clock.set_to(time_ns - clock.epoch_ns, time_ns))
    return state._replace(clock=clock._replace(synced_ns=None))


def _happened(constants: DeviceConstants, state: DeviceState, event: TimedEvent) -> DeviceState:
    match event:
        case TimedEvent(_, "clock_errs" | "clock_recovers", ReadingError() as error):
            errors = list(state.clock.errors)
            (errors.append if event.what == "clock_errs" else errors.remove)(error)
            return state._replace(clock=state.clock._replace(errors=tuple(errors)))
        case TimedEvent(time_ns, "interlock_opens" | "interlock_closes"):
            state = state._replace(interlock_closed=event.what == "interlock_closes")
            return enter(state, state.mode, time_ns, state.pending)
        case TimedEvent(time_ns, "power_off"):
            return enter(state, Mode.OFF, time_ns)
        case TimedEvent(time_ns, "power_on") if state.mode is Mode.OFF:
            return restart(constants, state, time_ns, cold=True)
    return state


def _event_ns(constants: DeviceConstants, state: DeviceState) -> int | None:
    left = constants.events[state.events_passed :]
    return left[0].at_ns if left else None


class ShotPolicy(NamedTuple):
    """Shot policy in a state of the device."""

    device: DeviceState
    status: Status
    """Device status in the packets."""
    fires: BoolArray | None
    """(1, beams) Whether each beam fires; None: all do."""
    is_plain: bool
    """Whether the device fires every shot with all beams and an exact clock, without any pending change."""

    def steady(self, shot: int, most: int, period_ns: int) -> tuple[int, bool]:
        """Number of shots from this one on, at most `most`, with the same policy, and whether they are silent."""
        device, divisor = self.device, self.device.settings.divisor
        if device.until_ns is not None:
            most = min(most, -((shot * period_ns - device.until_ns) // period_ns))
        if not device.measures:
            return most, True
        left_out = -shot % divisor
        return (min(most, left_out), True) if left_out else (most if divisor == 1 else 1, False)


def shot_policy(device: DeviceState, beam_count: int) -> ShotPolicy:
    """The shot policy of a device with this number of beams."""
    beams, settings = device.settings.beams, device.settings
    fires = np.array([[beams >> beam & 1 for beam in range(beam_count)]], dtype=np.bool_)
    is_plain = (
        device.mode is Mode.TRACK
        and device.until_ns is None
        and device.clock.is_exact
        and bool(fires.all())
        and (settings.divisor, settings.settling_ns) == (1, 0)
    )
    status = Status(device.mode, device.measures, device.clock_locked)
    return ShotPolicy(device, status, None if fires.all() else fires, is_plain)


class Settling(NamedTuple):
    """State carried from shot to shot."""

    pattern: int | None = None
    """Pattern of the last shot; None: unknown."""
    changed_ns: int | None = None
    """Start of the first shot with that pattern; None: long ago."""

    def settled(
        self, patterns: IntArray, first: int, period_ns: int, settling_ns: int
    ) -> tuple[BoolArray, Settling]:
        """Whether the beams have settled in each of consecutive shots, (shots,); and the state after them.

        Args:
            patterns: (shots,) number of each shot's pattern.
            first: number of the first shot.
            period_ns: from shot to shot.
            settling_ns: settling time, from the beginning of the first shot with a pattern.
        """
        pattern, changed_ns = self
        settled = np.ones(len(patterns), dtype=np.bool_)
        for row, chosen in enumerate(patterns.tolist()):
            begins_ns = (first + row) * period_ns
            if pattern is not None and chosen != pattern:
                changed_ns = begins_ns
            pattern = chosen
            settled[row] = changed_ns is None or begins_ns - changed_ns >= settling_ns
        return settled, Settling(pattern, changed_ns)
