"""What commands do to the device: the state after one, or why it is rejected."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from lidar_emu.device.modes import acquire, enter, restart, timed
from lidar_emu.device.rules import Rules
from lidar_emu.device.state import DeviceState, Due, Mode
from lidar_emu.scenario.device import LONGEST_STEP_S, MOST_HOUSEKEEPING_HZ

ACCEPTED = "accepted"
OUT_OF_STATE = "out_of_state"
OUT_OF_RANGE = "out_of_range"

PATTERN_OF_SWITCHES = 255
"""Stands for the scanner's own switches in the command `set_pattern`."""
_RATE_STEP_HZ = 1e-3
"""Of the command `set_rate_hz`."""

Value = int | float | str | None
"""An argument of a command; modes and restarts as words."""


class Order(NamedTuple):
    """A command and when it came."""

    name: str
    values: Mapping[str, Value]
    time_ns: int
    """Scenario time."""
    tone_at_ns: int
    """Scenario time of the last pulse or, without one, of the command's end."""


class _RejectedError(Exception):
    """Its argument is the verdict."""


def obey(rules: Rules, state: DeviceState, order: Order) -> tuple[DeviceState, str]:
    """The state after a command, and its verdict. A command that changes nothing returns the very state.

    Args:
        state: at the time of the command.
    """
    known = _COMMANDS.get(order.name)
    if known is None or state.mode not in known.modes:
        return state, OUT_OF_STATE
    try:
        after = known.act(rules, state, order)
    except _RejectedError as rejected:
        return state, str(rejected)
    return (state, ACCEPTED) if after == state else (timed(rules, after), ACCEPTED)


def _no_op(_rules: Rules, state: DeviceState, _order: Order) -> DeviceState:
    return state


def _set_mode(rules: Rules, state: DeviceState, order: Order) -> DeviceState:
    try:
        mode = Mode(str(order.values.get("mode")))
    except ValueError:
        raise _RejectedError(OUT_OF_RANGE) from None
    if mode not in _ARROWS:
        raise _RejectedError(OUT_OF_RANGE)
    if mode is state.mode or (state.mode is Mode.ACQUIRE and mode is Mode.TRACK):
        return state
    if state.mode not in _ARROWS[mode] or (state.mode is Mode.SAFE and not state.interlock_closed):
        raise _RejectedError(OUT_OF_STATE)
    match mode:
        case Mode.ACQUIRE | Mode.TRACK:
            return acquire(rules, state, order.time_ns)
        case Mode.SELF_TEST:
            standby = Due(order.time_ns + rules.self_test_ns, Mode.STANDBY)
            return enter(rules, state, mode, order.time_ns, (standby,))
    return enter(rules, state, mode, order.time_ns)


def _set_pattern(rules: Rules, state: DeviceState, order: Order) -> DeviceState:
    pattern = _whole(order, "pattern")
    if pattern != PATTERN_OF_SWITCHES and not 0 <= pattern < rules.pattern_count:
        raise _RejectedError(OUT_OF_RANGE)
    return _with(state, pattern=None if pattern == PATTERN_OF_SWITCHES else pattern)


def _set_rate(rules: Rules, state: DeviceState, order: Order) -> DeviceState:
    """Shots stay on the scenario's grid: the rate is the scenario's over a whole number."""
    rate_hz = _number(order, "rate_hz")
    divisor = max(1, round(rules.rate_hz / rate_hz)) if rate_hz >= _RATE_STEP_HZ else 1
    if not abs(rules.rate_hz / divisor - rate_hz) <= _RATE_STEP_HZ:  # NaN is no rate either
        raise _RejectedError(OUT_OF_RANGE)
    return _with(state, divisor=divisor)


def _enable_beams(rules: Rules, state: DeviceState, order: Order) -> DeviceState:
    beams = _whole(order, "beams")
    if not 0 <= beams < 1 << rules.beam_count:
        raise _RejectedError(OUT_OF_RANGE)
    return _with(state, beams=beams)


def _time_at_tone(_rules: Rules, state: DeviceState, order: Order) -> DeviceState:
    return state._replace(clock=state.clock.set_to(_whole(order, "tone_ns"), order.tone_at_ns))


def _set_parameter(_rules: Rules, state: DeviceState, order: Order) -> DeviceState:
    parameter = PARAMETERS.get(_whole(order, "parameter"))
    number = _number(order, "number")
    if parameter is None or not 0 <= number <= parameter.most:
        raise _RejectedError(OUT_OF_RANGE)
    return _with(state, **parameter.setting(number))


def _reset(rules: Rules, state: DeviceState, order: Order) -> DeviceState:
    kind = order.values.get("restart")
    if kind not in ("warm", "cold"):
        raise _RejectedError(OUT_OF_RANGE)
    return restart(rules, state, order.time_ns, cold=kind == "cold")


def _with(state: DeviceState, **settings: Any) -> DeviceState:
    return state._replace(settings=state.settings._replace(**settings))


def _number(order: Order, name: str) -> float:
    value = order.values.get(name)
    if value is None or isinstance(value, str):
        raise _RejectedError(OUT_OF_RANGE)
    return value


def _whole(order: Order, name: str) -> int:
    return int(_number(order, name))


class Parameter(NamedTuple):
    """What `set_parameter` can set."""

    meaning: str
    most: float
    """The least is 0."""
    setting: Callable[[float], dict[str, int | float]]


PARAMETERS = {
    0: Parameter("housekeeping rate, Hz", MOST_HOUSEKEEPING_HZ, lambda hz: {"housekeeping_rate_hz": hz}),
    1: Parameter("settling time, s", LONGEST_STEP_S, lambda s: {"settling_ns": round(s * 1e9)}),
    2: Parameter("acquisition time, s", LONGEST_STEP_S, lambda s: {"acquisition_ns": round(s * 1e9)}),
}

_READY = frozenset({Mode.STANDBY, Mode.ACQUIRE, Mode.TRACK})
_AWAKE = frozenset({Mode.SELF_TEST, Mode.SAFE, *_READY})
_ALWAYS = frozenset({Mode.FAULT, *_AWAKE})
_ARROWS = {
    Mode.STANDBY: _READY | {Mode.SAFE},
    Mode.SELF_TEST: frozenset({Mode.STANDBY}),
    Mode.ACQUIRE: _READY,
    Mode.TRACK: _READY,
    Mode.SAFE: _READY,
}
"""Modes that can be commanded, each from which modes."""


class _Known(NamedTuple):
    modes: frozenset[Mode]
    act: Callable[[Rules, DeviceState, Order], DeviceState]


_COMMANDS = {
    "no_op": _Known(_ALWAYS, _no_op),
    "set_mode": _Known(_AWAKE, _set_mode),
    "set_pattern": _Known(_READY, _set_pattern),
    "set_rate_hz": _Known(_READY, _set_rate),
    "enable_beams": _Known(_READY, _enable_beams),
    "time_at_tone": _Known(_AWAKE, _time_at_tone),
    "set_parameter": _Known(_READY, _set_parameter),
    "reset": _Known(_ALWAYS, _reset),
}
