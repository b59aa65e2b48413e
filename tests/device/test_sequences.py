"""What a device carries from command to command, over drawn sequences: settings, clock, lock and temperature, against
references that remember everything since power-up; and the same from another origin of time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import exp
from typing import Any

import pytest
from devices import MS, Unit, constants
from hypothesis import example, given
from hypothesis import strategies as st

from lidar_emu.device.commands import DeviceCommand, DeviceTimeline
from lidar_emu.device.modes import advance, initial
from lidar_emu.device.state import AMBIENT_C, RISE_K, TIME_CONSTANT_S, DeviceState, TimedEvent

HOLDOVER_MS = 4000
BEHAVIOUR: dict[str, Any] = {
    "start": "standby",
    "clock": {"offset_s": 0.5, "drift_ppm": 40.0, "holdover_s": HOLDOVER_MS / 1000},
}
SETTINGS = {
    "enable_beams": ("beams", st.integers(1, 15), lambda beams: {"beams": beams}),
    "set_pattern": ("pattern", st.integers(0, 1), lambda pattern: {"pattern": pattern}),
    "set_rate_hz": ("rate_hz", st.sampled_from([20.0, 10.0, 5.0]), lambda hz: {"divisor": round(20 / hz)}),
}
PARAMETERS = [("housekeeping_rate_hz", 1.0), ("settling_ns", 1e9), ("acquisition_ns", 1e9)]


@st.composite
def orders(draw: st.DrawFn) -> tuple[str, dict[str, Any]]:
    """A command with its arguments."""
    name = draw(
        st.sampled_from(
            ["set_mode", "set_mode", "set_mode", "reset", "time_at_tone", "set_parameter", *SETTINGS]
        )
    )
    match name:
        case "set_mode":
            return name, {"mode": draw(st.sampled_from(["track", "standby", "safe"]))}
        case "reset":
            return name, {"restart": draw(st.sampled_from(["warm", "warm", "cold"]))}
        case "time_at_tone":
            return name, {"tone_ns": draw(st.integers(0, 10**12))}
        case "set_parameter":
            return name, {
                "parameter": draw(st.integers(0, 2)),
                "number": draw(st.sampled_from([0.0, 0.5, 2.0])),
            }
    key, values, _ = SETTINGS[name]
    return name, {key: draw(values)}


SEQUENCES = st.lists(st.tuples(st.integers(1, 3000), orders()), min_size=1, max_size=15)
"""Each command with the milliseconds since the one before."""


@dataclass
class Remembered:
    """All that was accepted since power-up."""

    settings: dict[str, Any]
    synced_ms: int = 0
    shown_ns: int = 500 * MS
    set_ms: int = 0
    lit_ms: list[list[int]] = field(default_factory=list)
    defaults: dict[str, Any] = field(default_factory=dict)

    def accept(self, time_ms: int, name: str, values: dict[str, Any]) -> None:
        """Take note of a command that was accepted."""
        if name in SETTINGS:
            key, _, setting = SETTINGS[name]
            self.settings |= setting(values[key])
        elif name == "set_parameter":
            key, unit = PARAMETERS[values["parameter"]]
            self.settings[key] = values["number"] * unit
        elif name == "time_at_tone":
            self.synced_ms, self.set_ms, self.shown_ns = time_ms, time_ms, values["tone_ns"]
        elif values.get("restart") == "cold":
            self.settings, self.synced_ms = dict(self.defaults), time_ms
            self.set_ms, self.shown_ns = time_ms, (time_ms + 500) * MS

    def note_laser(self, is_on: bool, time_ms: int) -> None:
        """Take note of the laser, in each millisecond in which it may change."""
        was_on = bool(self.lit_ms) and len(self.lit_ms[-1]) == 1
        if is_on and not was_on:
            self.lit_ms.append([time_ms])
        elif was_on and not is_on:
            self.lit_ms[-1].append(time_ms)

    def temperature_c(self, time_ms: int) -> float:
        """Sum of what each time of light has left."""
        excess = 0.0
        for first_ms, *last in self.lit_ms:
            until_ms = last[0] if last else time_ms
            left = [exp(-(time_ms - each) / 1000 / TIME_CONSTANT_S) for each in (until_ms, first_ms)]
            excess += RISE_K * (left[0] - left[1])
        return AMBIENT_C + excess

    def assert_same(self, state: DeviceState, time_ms: int) -> None:
        """Compare all that is carried."""
        assert {key: getattr(state.settings, key) for key in self.settings} == self.settings
        assert state.clock_locked == (time_ms < self.synced_ms + HOLDOVER_MS)
        elapsed_ns = (time_ms - self.set_ms) * MS
        assert state.clock.reads_ns(time_ms * MS) == self.shown_ns + elapsed_ns + round(elapsed_ns * 40e-6)
        found_c = state.thermal.temperature_c(time_ms * MS)
        assert found_c == pytest.approx(self.temperature_c(time_ms), abs=1e-6)


@example([(1, ("set_parameter", {"parameter": 2, "number": 0.5})), (1, ("reset", {"restart": "warm"}))])
@example([(1, ("time_at_tone", {"tone_ns": 7})), (3999, ("set_mode", {"mode": "safe"})), (1, ("no_op", {}))])
@given(SEQUENCES)
def test_what_is_carried_is_what_was_accepted_since_power_up(sequence: list[tuple[int, Any]]) -> None:
    unit, time_ms = Unit(**BEHAVIOUR), 0
    defaults = unit.constants.defaults._asdict()
    remembered = Remembered(dict(defaults), defaults=defaults)
    for gap_ms, (name, values) in sequence:
        for step_ms in range(time_ms, time_ms + gap_ms):
            if unit.state.until_ns is not None and unit.state.until_ns <= step_ms * MS:
                remembered.note_laser(unit.at(step_ms).measures, step_ms)
        time_ms += gap_ms
        remembered.note_laser(unit.at(time_ms).measures, time_ms)
        if unit.command(time_ms, name, **values) == "accepted":
            remembered.accept(time_ms, name, values)
        remembered.note_laser(unit.state.measures, time_ms)
        remembered.assert_same(unit.at(time_ms), time_ms)


WHAT_HAPPENS = st.sampled_from(["interlock_opens", "interlock_closes", "power_off", "power_on"])


def test_a_warm_restart_acquires_for_the_time_that_was_set() -> None:
    unit = Unit(after_boot="track", warm_restart_s=0.5)
    assert unit.command(100, "set_parameter", parameter=2, number=1.0) == "accepted"
    assert unit.command(200, "reset", restart="warm") == "accepted"
    assert [str(unit.at(time_ms).mode) for time_ms in (700, 1699, 1700)] == ["acquire", "acquire", "track"]


EVENTS = st.lists(
    st.tuples(st.integers(1, 20_000), WHAT_HAPPENS), max_size=3, unique_by=lambda event: event[0]
)


@given(SEQUENCES, EVENTS, st.integers(1, 20_000), st.sampled_from(["standby", "track"]))
@example(
    [(1, ("set_parameter", {"parameter": 2, "number": 0.0})), (1, ("set_mode", {"mode": "track"}))],
    [],
    1,
    "standby",
)
def test_another_origin_of_time_changes_nothing(
    sequence: list[tuple[int, Any]], events: list[tuple[int, str]], zero_ms: int, after_boot: str
) -> None:
    """A flight on command counts its times from the command on."""
    timed = [(time_ms / 1000, what) for time_ms, what in sorted(events)]
    rules = constants(timed, **BEHAVIOUR, after_boot=after_boot)
    zero_ns, time_ns = zero_ms * MS, 0
    whole = DeviceTimeline(rules, initial(rules))
    parted = DeviceTimeline(rules, initial(rules))
    moved = replace(rules, events=tuple(TimedEvent(each.at_ns - zero_ns, each.what) for each in rules.events))
    origin_ns = 0
    for gap_ms, (name, values) in sequence:
        time_ns += gap_ms * MS
        if time_ns >= zero_ns and not origin_ns:
            parted.start_flight(moved, zero_ns)
            origin_ns = zero_ns
        (after, verdict), (_, moved_verdict) = (
            device.execute(DeviceCommand(name, values, time_ns - shift_ns, time_ns - shift_ns))
            for device, shift_ns in ((whole, 0), (parted, origin_ns))
        )
        assert moved_verdict == verdict
        # What is due at once, such as the end of an acquisition that takes no time, follows the command.
        assert after is None or advance(rules, after, time_ns) == whole.at(time_ns)
        for later_ns in (0, 700 * MS, 5000 * MS):
            states = whole.at(time_ns + later_ns), parted.at(time_ns + later_ns - origin_ns)
            assert _seen(states[0], time_ns + later_ns, 0) == _seen(states[1], time_ns + later_ns, origin_ns)


def _seen(state: DeviceState, time_ns: int, origin_ns: int) -> tuple[Any, ...]:
    """What a host can see, in times since power-up."""
    at_ns = time_ns - origin_ns
    temperature_c = state.thermal.temperature_c(at_ns)
    until_ns = None if state.until_ns is None else state.until_ns + origin_ns
    times = state.clock.reads_ns(at_ns), state.restarted_ns + origin_ns, until_ns
    return state.mode, state.settings, state.clock_locked, state.restarts, *times, temperature_c
