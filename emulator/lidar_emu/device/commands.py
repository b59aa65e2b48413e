"""Commands: the state of the device after each, or the reason for rejecting it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from lidar_emu.device.modes import acquire, advance, counted_from, enter, restart, timed
from lidar_emu.device.state import DeviceConstants, DeviceState, Mode, PendingTransition, TimedEvent
from lidar_emu.scenario.device import LONGEST_STEP_S, MOST_HOUSEKEEPING_HZ

ACCEPTED = "accepted"
OUT_OF_STATE = "out_of_state"
OUT_OF_RANGE = "out_of_range"

PATTERN_OF_SWITCHES = 255
"""Argument of `set_pattern` that returns the choice to the scanner's own switches."""
_RATE_STEP_HZ = 1e-3
"""Resolution of the command `set_rate_hz`."""

Value = int | float | str | None
"""An argument of a command; modes and kinds of restart as words."""


class DeviceCommand(NamedTuple):
    """A command and its time."""

    name: str
    values: Mapping[str, Value]
    time_ns: int
    """Scenario time."""
    tone_at_ns: int
    """Scenario time of the last synchronisation pulse or, without one, of the command's end."""


class _RejectedError(Exception):
    """A command is rejected; the argument is the verdict."""


def execute(
    constants: DeviceConstants, state: DeviceState, command: DeviceCommand
) -> tuple[DeviceState, str]:
    """State after a command, and the verdict. A command that changes nothing returns the same object.

    Args:
        state: state at the time of the command.
    """
    handler = _COMMANDS.get(command.name)
    if handler is None or state.mode not in handler.modes:
        return state, OUT_OF_STATE
    try:
        after = handler.apply(constants, state, command)
    except _RejectedError as rejected:
        return state, str(rejected)
    return (state, ACCEPTED) if after == state else (timed(constants, after), ACCEPTED)


def _set_mode(constants: DeviceConstants, state: DeviceState, command: DeviceCommand) -> DeviceState:
    try:
        mode = Mode(str(command.values.get("mode")))
    except ValueError:
        raise _RejectedError(OUT_OF_RANGE) from None
    if mode not in _TRANSITIONS:
        raise _RejectedError(OUT_OF_RANGE)
    if mode is state.mode or (state.mode is Mode.ACQUIRE and mode is Mode.TRACK):
        return state
    if state.mode not in _TRANSITIONS[mode] or (state.mode is Mode.SAFE and not state.interlock_closed):
        raise _RejectedError(OUT_OF_STATE)
    match mode:
        case Mode.ACQUIRE | Mode.TRACK:
            return acquire(state, command.time_ns)
        case Mode.SELF_TEST:
            standby = PendingTransition(command.time_ns + constants.self_test_ns, Mode.STANDBY)
            return enter(state, mode, command.time_ns, (standby,))
    return enter(state, mode, command.time_ns)


def _set_pattern(constants: DeviceConstants, state: DeviceState, command: DeviceCommand) -> DeviceState:
    pattern = _whole(command, "pattern")
    if pattern != PATTERN_OF_SWITCHES and not 0 <= pattern < constants.pattern_count:
        raise _RejectedError(OUT_OF_RANGE)
    return _with(state, pattern=None if pattern == PATTERN_OF_SWITCHES else pattern)


def _set_rate(constants: DeviceConstants, state: DeviceState, command: DeviceCommand) -> DeviceState:
    """Set the shot rate; shots stay on the scenario's grid, since the rate must be the scenario's rate divided by an
    integer."""
    rate_hz = _number(command, "rate_hz")
    divisor = max(1, round(constants.rate_hz / rate_hz)) if rate_hz >= _RATE_STEP_HZ else 1
    if not abs(constants.rate_hz / divisor - rate_hz) <= _RATE_STEP_HZ:  # Also rejects NaN.
        raise _RejectedError(OUT_OF_RANGE)
    return _with(state, divisor=divisor)


def _enable_beams(constants: DeviceConstants, state: DeviceState, command: DeviceCommand) -> DeviceState:
    beams = _whole(command, "beams")
    if not 0 <= beams < 1 << constants.beam_count:
        raise _RejectedError(OUT_OF_RANGE)
    return _with(state, beams=beams)


def _time_at_tone(constants: DeviceConstants, state: DeviceState, command: DeviceCommand) -> DeviceState:
    if constants.clock.source is not None:
        raise _RejectedError(OUT_OF_STATE)
    return state._replace(clock=state.clock.set_to(_whole(command, "tone_ns"), command.tone_at_ns))


def _set_parameter(_rules: DeviceConstants, state: DeviceState, command: DeviceCommand) -> DeviceState:
    parameter = PARAMETERS.get(_whole(command, "parameter"))
    number = _number(command, "number")
    if parameter is None or not 0 <= number <= parameter.most:
        raise _RejectedError(OUT_OF_RANGE)
    return _with(state, **parameter.setting(number))


def _reset(constants: DeviceConstants, state: DeviceState, command: DeviceCommand) -> DeviceState:
    kind = command.values.get("restart")
    if kind not in ("warm", "cold"):
        raise _RejectedError(OUT_OF_RANGE)
    return restart(constants, state, command.time_ns, cold=kind == "cold")


def _with(state: DeviceState, **settings: Any) -> DeviceState:
    return state._replace(settings=state.settings._replace(**settings))


def _number(command: DeviceCommand, name: str) -> float:
    value = command.values.get(name)
    if value is None or isinstance(value, str):
        raise _RejectedError(OUT_OF_RANGE)
    return value


def _whole(command: DeviceCommand, name: str) -> int:
    return int(_number(command, name))


class Parameter(NamedTuple):
    """A parameter of the command `set_parameter`."""

    meaning: str
    most: float
    """Maximum; the minimum is 0."""
    setting: Callable[[float], dict[str, int | float]]


PARAMETERS = {
    0: Parameter("housekeeping rate, Hz", MOST_HOUSEKEEPING_HZ, lambda hz: {"housekeeping_rate_hz": hz}),
    1: Parameter("settling time, s", LONGEST_STEP_S, lambda s: {"settling_ns": round(s * 1e9)}),
    2: Parameter("acquisition time, s", LONGEST_STEP_S, lambda s: {"acquisition_ns": round(s * 1e9)}),
}

_READY = frozenset({Mode.STANDBY, Mode.ACQUIRE, Mode.TRACK})
_AWAKE = frozenset({Mode.SELF_TEST, Mode.SAFE, *_READY})
_ALWAYS = frozenset({Mode.FAULT, *_AWAKE})
_TRANSITIONS = {
    Mode.STANDBY: _READY | {Mode.SAFE},
    Mode.SELF_TEST: frozenset({Mode.STANDBY}),
    Mode.ACQUIRE: _READY,
    Mode.TRACK: _READY,
    Mode.SAFE: _READY,
}
"""Modes that can be commanded, each with the modes from which it can be reached."""


class _Handler(NamedTuple):
    modes: frozenset[Mode]
    apply: Callable[[DeviceConstants, DeviceState, DeviceCommand], DeviceState]


_COMMANDS = {
    "no_op": _Handler(_ALWAYS, lambda _rules, state, _command: state),
    "set_mode": _Handler(_AWAKE, _set_mode),
    "set_pattern": _Handler(_READY, _set_pattern),
    "set_rate_hz": _Handler(_READY, _set_rate),
    "enable_beams": _Handler(_READY, _enable_beams),
    "time_at_tone": _Handler(_AWAKE, _time_at_tone),
    "set_parameter": _Handler(_READY, _set_parameter),
    "reset": _Handler(_ALWAYS, _reset),
}


def modes_of_commands() -> dict[str, list[str]]:
    """Modes in which each command is followed."""
    return {name: [mode for mode in Mode if mode in handler.modes] for name, handler in _COMMANDS.items()}


def followed_arguments(rate_hz: float, beam_count: int, pattern_count: int) -> dict[str, str]:
    """What a device follows of the arguments of its commands, as text by command."""
    parameters = "; ".join(f"{number}: 0 to {each.most:g}" for number, each in PARAMETERS.items())
    return {
        "set_mode": ", ".join(_TRANSITIONS),
        "set_pattern": f"0 to {pattern_count - 1}, {PATTERN_OF_SWITCHES}",
        "set_rate_hz": f"{rate_hz:g}, or that divided by a whole number, to {_RATE_STEP_HZ:g} Hz",
        "enable_beams": f"beams 0 to {beam_count - 1}, or none",
        "time_at_tone": "times that the time code holds to the end of the run",
        "set_parameter": parameters,
    }


def modes_before() -> dict[str, list[str]]:
    """For each mode that `set_mode` knows, the modes from which the device changes to it."""
    return {mode: [before for before in Mode if before in _TRANSITIONS[mode]] for mode in _TRANSITIONS}


_STORED = 256


class DeviceTimeline:
    """State from each command on. It depends on time and commands alone, never on measurements."""

    def __init__(self, constants: DeviceConstants, state: DeviceState) -> None:
        self.constants = constants
        self._first = state
        self._since: deque[tuple[int, DeviceState]] = deque(maxlen=_STORED)

    def at(self, time_ns: int) -> DeviceState:
        """State at a scenario time, without later commands."""
        for from_ns, state in reversed(self._since):
            if from_ns <= time_ns:
                return advance(self.constants, state, time_ns)
        return advance(self.constants, self._first, time_ns)

    def in_order(self, time_ns: int) -> int:
        """This scenario time or, if a command counts from a later one, that one's."""
        return max(time_ns, self._since[-1][0]) if self._since else time_ns

    def execute(self, command: DeviceCommand) -> tuple[DeviceState | None, str]:
        """Execute a command; commands must be in order of time.

        Returns:
            The state after it, None if nothing changes; and its verdict.
        """
        before = self.at(command.time_ns)
        after, verdict = execute(self.constants, before, command)
        if after is before:
            return None, verdict
        self._since.append((command.time_ns, after))
        return after, verdict

    def use_system_clock(self, time_ns: int, epoch_ns: int, locked: bool) -> DeviceState | None:
        """Let the clock read 0 at the scenario time `epoch_ns`, and be locked or not, from `time_ns` on.

        Returns:
            The state then; None if nothing changes.
        """
        before = self.at(time_ns)
        if (before.clock.epoch_ns, before.clock_locked) == (epoch_ns, locked):
            return None
        clock = before.clock._replace(epoch_ns=epoch_ns).set_to(time_ns - epoch_ns, time_ns)
        clock = clock if locked else clock._replace(synced_ns=None)
        after = timed(self.constants, before._replace(clock=clock))
        self._since.append((time_ns, after))
        return after

    def use_events(self, events: tuple[TimedEvent, ...]) -> None:
        """Replace the events of the device; events up to now must be the same as before."""
        self.constants = replace(self.constants, events=events)
        self._first = timed(self.constants, self._first)
        since = [(from_ns, timed(self.constants, state)) for from_ns, state in self._since]
        self._since = deque(since, maxlen=_STORED)

    def start_flight(self, constants: DeviceConstants, zero_ns: int) -> DeviceState:
        """Count times from what was `zero_ns`, and use these constants from now on; returns the state then."""
        self.constants, self._first = constants, counted_from(constants, self.at(zero_ns), zero_ns)
        self._since.clear()
        return self._first
