"""Modes: what follows by itself, what each command does in each, against tables written by hand."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from devices import MS, Unit, constants
from hypothesis import given, settings
from hypothesis import strategies as st

import lidar_protocol
from lidar_emu.device.commands import DeviceCommand, execute
from lidar_emu.device.modes import advance, initial, timed
from lidar_emu.device.state import Mode


def reached(mode: str) -> Unit:
    """A device that is in a mode at 10 s, and stays there for long without a command."""
    unit = Unit(start="boot", boot_s=2.0, self_test_s=20.0 if mode == "self_test" else 1.0, acquisition_s=60.0,
                events=[(9.0, "interlock_opens")] if mode == "fault" else [])  # fmt: skip
    unit.at(5000)
    if mode in ("acquire", "track", "safe"):
        if mode == "track":
            assert unit.command(5500, "set_parameter", parameter=2, number=0.5) == "accepted"
        assert unit.command(6000, "set_mode", mode=mode) == "accepted"
    unit.at(10_000)
    assert unit.mode == mode
    return unit


def test_a_device_boots_and_tests_itself_when_it_is_switched_on() -> None:
    unit = Unit(start="boot")
    steps = [(0, "boot"), (1999, "boot"), (2000, "self_test"), (2999, "self_test"), (3000, "standby")]
    for time_ms, mode in [*steps, (1e6, "standby")]:
        unit.at(time_ms)
        assert unit.mode == mode
    assert unit.state.restarts == 0


@pytest.mark.parametrize(("restart", "measures_again_ms"), [("warm", 500), ("cold", 3000)])
def test_a_device_that_nobody_commands_goes_on_by_itself(restart: str, measures_again_ms: int) -> None:
    unit = Unit(
        start="boot", after_boot="track", boot_s=2.0, self_test_s=1.0, warm_restart_s=0.5, acquisition_s=0.25
    )
    assert unit.at(2999.9).mode is Mode.SELF_TEST
    assert unit.at(3000).mode is Mode.ACQUIRE
    assert unit.at(3249.9).mode is Mode.ACQUIRE
    assert unit.at(3250).mode is Mode.TRACK
    assert unit.state.until_ns is None
    assert unit.command(5000, "reset", restart=restart) == "accepted"
    assert not unit.at(4999.9 + measures_again_ms).measures
    assert unit.at(5000 + measures_again_ms).mode is Mode.ACQUIRE
    assert unit.at(5250 + measures_again_ms).mode is Mode.TRACK


def test_an_open_interlock_keeps_it_from_going_on_by_itself() -> None:
    unit = Unit(start="boot", after_boot="track", events=[(1.0, "interlock_opens")])
    assert unit.at(60_000).mode is Mode.FAULT


A, S, R = "accepted", "out_of_state", "out_of_range"
VERDICTS = {
    #                                    self_test standby acquire track fault safe
    ("no_op",):                             (A, A, A, A, A, A),
    ("set_mode", "mode", "standby"):        (S, A, A, A, S, A),
    ("set_mode", "mode", "self_test"):      (A, A, S, S, S, S),
    ("set_mode", "mode", "acquire"):        (S, A, A, A, S, S),
    ("set_mode", "mode", "track"):          (S, A, A, A, S, S),
    ("set_mode", "mode", "safe"):           (S, A, A, A, S, A),
    ("set_mode", "mode", "fault"):          (R, R, R, R, S, R),
    ("set_mode", "mode", "off"):            (R, R, R, R, S, R),
    ("set_pattern", "pattern", 1):          (S, A, A, A, S, S),
    ("set_pattern", "pattern", 255):        (S, A, A, A, S, S),
    ("set_pattern", "pattern", 2):          (S, R, R, R, S, S),
    ("set_rate_hz", "rate_hz", 5.0):        (S, A, A, A, S, S),
    ("set_rate_hz", "rate_hz", 6.667):      (S, A, A, A, S, S),
    ("set_rate_hz", "rate_hz", 8.0):        (S, R, R, R, S, S),
    ("set_rate_hz", "rate_hz", 40.0):       (S, R, R, R, S, S),
    ("enable_beams", "beams", 0b0101):      (S, A, A, A, S, S),
    ("enable_beams", "beams", 0b10000):     (S, R, R, R, S, S),
    ("time_at_tone", "tone_ns", 10**9):     (A, A, A, A, S, A),
    ("reset", "restart", "cold"):           (A, A, A, A, A, A),
    ("reset", "restart", "tepid"):          (R, R, R, R, R, R),
    ("self_destruct",):                     (S, S, S, S, S, S),
}  # fmt: skip
MODES = ("self_test", "standby", "acquire", "track", "fault", "safe")


@pytest.mark.parametrize("mode", MODES)
def test_each_command_in_each_mode(mode: str) -> None:
    for (name, *argument), verdicts in VERDICTS.items():
        unit = reached(mode)
        verdict = unit.command(10_000, name, **dict([argument] if argument else []))
        assert verdict == verdicts[MODES.index(mode)], (name, argument)
        if verdict != A:
            assert unit.state == reached(mode).state, "a command that is rejected changes nothing"


def test_the_interface_document_states_the_same() -> None:
    document = (Path(lidar_protocol.__file__).parent / "INTERFACE.md").read_text(encoding="utf-8")
    section = document[document.index("### Commands and modes") : document.index("### Times")]
    commands, targets = (
        {
            name: set(modes.split(", "))
            for name, modes in re.findall(r"^\| `(\w+)` \| ([a-z_, ]+) \|", part, re.M)
        }
        for part in section.split("| `set_mode` to | from |")
    )
    for (name, *argument), verdicts in VERDICTS.items():
        followed = {mode for mode, verdict in zip(MODES, verdicts, strict=True) if verdict != S}
        if name == "set_mode" and argument[1] in targets:
            assert followed == targets[argument[1]] | {argument[1]}
        elif name != "set_mode":
            assert followed == commands.get(name, set()), name
    assert commands["set_mode"] == set(MODES) - {"fault"}
    assert commands["set_parameter"] == commands["set_pattern"]


@pytest.mark.parametrize("mode", [*MODES, "boot", "off"])
def test_where_the_laser_is_on(mode: str) -> None:
    unit = Unit(start="boot") if mode in ("boot", "off") else reached(mode)
    if mode == "off":
        unit.state = unit.state._replace(mode=Mode.OFF)
    assert unit.state.measures == (mode in ("acquire", "track"))
    assert unit.state.answers == (mode not in ("boot", "off"))


def test_an_open_interlock_is_left_by_reset_once_it_is_closed() -> None:
    opened_and_closed = [(1.0, "interlock_opens"), (8.0, "interlock_closes")]
    unit = Unit(events=opened_and_closed)
    assert unit.at(999).mode is Mode.TRACK
    assert unit.at(1000).mode is Mode.FAULT
    assert not unit.state.interlock_closed
    assert unit.command(1500, "reset", restart="warm") == "accepted"
    assert unit.at(2000).mode is Mode.FAULT, "it is still open"
    assert unit.at(8000).mode is Mode.FAULT, "a fault is not left by itself"
    assert unit.command(8500, "reset", restart="warm") == "accepted"
    assert unit.at(9000).mode is Mode.STANDBY


def test_in_safe_the_interlock_may_open_but_standby_needs_it_closed() -> None:
    unit = Unit(events=[(2.0, "interlock_opens")])
    assert unit.command(1000, "set_mode", mode="safe") == "accepted"
    assert unit.at(3000).mode is Mode.SAFE
    assert unit.command(3000, "set_mode", mode="standby") == "out_of_state"


def test_power_that_fails_and_comes_back() -> None:
    unit = Unit(events=[(1.0, "power_off"), (2.0, "power_on"), (3.0, "power_on")])
    assert unit.command(500, "enable_beams", beams=1) == "accepted"
    assert unit.at(1000).mode is Mode.OFF
    assert [unit.at(t).mode for t in (2000, 4000, 5000)] == [Mode.BOOT, Mode.SELF_TEST, Mode.STANDBY]
    assert unit.state.restarts == 1
    assert unit.state.settings.beams == 15


ARROWS = {
    "off": {"boot", "track"},
    "boot": {"self_test", "standby", "fault", "off"},
    "self_test": {"standby", "fault", "boot", "off"},
    "standby": {"acquire", "self_test", "safe", "fault", "boot", "off"},
    "acquire": {"acquire", "track", "standby", "safe", "fault", "boot", "off"},
    "track": {"acquire", "standby", "safe", "fault", "boot", "off"},
    "fault": {"boot", "off"},
    "safe": {"standby", "boot", "off"},
}
COMMANDS = st.one_of(
    st.tuples(st.just("set_mode"), st.fixed_dictionaries({"mode": st.sampled_from([*Mode, None, "x", 3])})),
    st.tuples(st.just("reset"), st.fixed_dictionaries({"restart": st.sampled_from(["warm", "cold", None])})),
    st.tuples(
        st.just("set_parameter"),
        st.fixed_dictionaries({"parameter": st.integers(0, 3), "number": st.one_of(st.none(), st.floats())}),
    ),
    st.tuples(st.just("set_rate_hz"), st.fixed_dictionaries({"rate_hz": st.floats()})),
    st.tuples(st.just("time_at_tone"), st.fixed_dictionaries({"tone_ns": st.integers(0, 2**62)})),
    st.tuples(st.sampled_from(["no_op", "enable_beams", "set_pattern", "nonsense"]), st.just({})),
)
EVENTS = st.lists(
    st.tuples(
        st.integers(0, 20_000),
        st.sampled_from(["interlock_opens", "interlock_closes", "power_off", "power_on"]),
    ),
    max_size=6,
)


@settings(max_examples=300, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 20_000), COMMANDS), max_size=12),
    EVENTS,
    st.sampled_from(["boot", "track"]),
)
def test_modes_change_along_the_arrows_alone(commands: Any, events: Any, start: str) -> None:
    """Whatever is commanded and happens, whenever it does."""
    behaviour = constants(
        start=start, events=[(t / 1000, what) for t, what in sorted(events)], clock={"holdover_s": 2.0}
    )
    state, times = initial(behaviour), sorted(commands, key=lambda each: each[0])
    for time_ms, (name, values) in times:
        while state.until_ns is not None and state.until_ns <= time_ms * MS:
            after = advance(behaviour, state, state.until_ns)
            # Changes that fall on one instant are taken one after another.
            assert after.mode is state.mode or after.mode in reachable(state.mode), (state.mode, after.mode)
            assert after.until_ns is None or after.until_ns > state.until_ns
            state = after
        after, verdict = execute(behaviour, state, DeviceCommand(name, values, time_ms * MS, time_ms * MS))
        assert verdict in ("accepted", "out_of_state", "out_of_range")
        assert after.mode is state.mode or after.mode in ARROWS[state.mode]
        assert timed(behaviour, after) == after
        state = after
    assert not (state.measures and not state.interlock_closed)


def reachable(mode: str) -> set[str]:
    """In any number of steps."""
    found, new = set(ARROWS[mode]), set(ARROWS[mode])
    while new:
        new = {end for step in new for end in ARROWS[step]} - found
        found |= new
    return found


@settings(max_examples=100, deadline=None)
@given(st.lists(st.integers(0, 12_000), max_size=10), EVENTS)
def test_it_does_not_matter_how_often_one_looks(looks: list[int], events: Any) -> None:
    unit = Unit(start="boot", events=[(t / 1000, what) for t, what in sorted(events)])
    at_once = advance(unit.constants, unit.state, 12_000 * MS)
    for time_ms in sorted(looks):
        unit.at(time_ms)
    assert unit.at(12_000) == at_once
