"""A session with a device: which shots are fired, how they are numbered and dated, however they are grouped."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from devices import MS
from hypothesis import given, settings
from hypothesis import strategies as st

import lidar_emu
from lidar_emu.device.commands import DeviceCommand, DeviceTimeline
from lidar_emu.device.modes import advance, firing, initial
from lidar_emu.device.state import DeviceConstants, Mode, device_constants
from lidar_emu.faults.packets import faulty_encoder
from lidar_emu.receiver.returns import Reason
from lidar_emu.scenario.schema import DeviceBehaviour, FlightScenario
from lidar_emu.session import Block, Session
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import Model, build_model
from lidar_emu.wire import Encoder
from lidar_protocol import Message, SerialReceiver, default_interface

OFF = "[{kind: brown_out, from_s: 1.3, to_s: 1.7}]"
LOCKED_OUT = "[{kind: interlock, from_s: 0.95}]"
FAULTS = "[{kind: frozen_counter, from_s: 0.4, to_s: 0.9}, {kind: stuck, from_s: 0.6, to_s: 1.2, beams: [1]}]"


@cache
def flown(faults: str) -> tuple[FlightScenario, Model]:
    options = {"level": "geometric", "site": "flat", "duration_s": "4", "faults": faults}
    scenario = lidar_emu.load("descent.yaml", options)
    assert isinstance(scenario, FlightScenario)
    return scenario, build_model(scenario)


def begun(faults: str = "[]", **part: Any) -> tuple[Session, DeviceConstants]:
    scenario, model = flown(faults)
    constants = device_constants(DeviceBehaviour.model_validate(part), 20.0, 4, 2, faults=scenario.faults)
    encoder = Encoder(scenario.wire, False, False, 4)
    faulty = faulty_encoder(scenario, encoder, False)
    return Session(model, encoder, 100, faulty, constants), constants


def all_of(session: Session, most: int = 100) -> list[Block]:
    blocks = []
    while (block := session.shoot(most)) is not None:
        blocks.append(block)
    return blocks


def packets_of(blocks: list[Block]) -> list[Any]:
    return [packet for block in blocks for packet in block.packets]


def decoded(blocks: list[Block]) -> dict[int, Message]:
    """What was sent, by the number of the shot in the scenario."""
    receiver = SerialReceiver(default_interface())
    found: dict[int, Message] = {}
    for block in blocks:
        for shot, packet in zip(block.measurement.shot.tolist(), block.packets, strict=True):
            for message in receiver.receive(packet):
                assert isinstance(message, Message)
                found[shot] = message
    assert receiver.counters.bad_crc == receiver.counters.sequence_gaps == 0
    return found


def after(constants: DeviceConstants, *orders: tuple[float, str, dict[str, Any]]) -> Any:
    """The state after commands, each at a time in milliseconds."""
    device, state = DeviceTimeline(constants, initial(constants)), None
    for time_ms, name, values in orders:
        changed, verdict = device.execute(
            DeviceCommand(name, values, round(time_ms * MS), round(time_ms * MS))
        )
        assert verdict == "accepted"
        state = changed or state
    return state


def test_nothing_is_sent_before_the_first_measurement_and_then_shots_count_from_0() -> None:
    session, constants = begun(start="boot", boot_s=0.5, self_test_s=0.52, acquisition_s=0.2)
    early = [session.shoot(100) for _ in range(2)]
    assert [len(block.packets) for block in early if block] == [
        10,
        11,
    ]  # self-test until 1.02 s: shot 21 at 1.05
    session.use_device(after(constants, (1100, "set_mode", {"mode": "track"})))
    blocks = all_of(session)
    sent = decoded(blocks)
    assert list(sent) == list(range(21, 80))
    assert [message.shot for message in sent.values()] == list(range(59))
    modes = {1: "standby", 3: "acquire", 4: "track"}
    assert [modes[int(message.header["mode"] or 0)] for message in sent.values()] == ["acquire"] * 5 + [
        "track"
    ] * 54
    assert all(message.header["laser_on"] for message in sent.values())
    idle = early[0]
    assert idle is not None
    assert idle.silent
    assert set(idle.packets) == {b""}
    assert np.isnan(idle.measurement.range_m).all()
    assert set(idle.measurement.reason.ravel()) == {Reason.NOT_FIRED}
    assert np.isfinite(idle.measurement.position_site_m).all(), "where the vehicle is, is known in any mode"


def test_what_is_fired_is_measured_as_ever() -> None:
    """Standing by, a lower rate, and other shots before change nothing of a shot but its number."""
    plain = decoded(all_of(begun()[0]))
    session, constants = begun(start="standby", acquisition_s=0.0)
    session.use_device(
        after(constants, (300, "set_mode", {"mode": "track"}), (400, "set_rate_hz", {"rate_hz": 20 / 3}))
    )
    sent = decoded(all_of(session))
    assert list(sent) == list(range(0, 80, 3))
    assert [message.shot for message in sent.values()] == list(range(27))
    for shot, message in sent.items():
        assert message.beams == plain[shot].beams
        assert dict(message.header) | {"shot": shot, "mode": 4} == dict(plain[shot].header)


@pytest.mark.parametrize("faults", ["[]", OFF, LOCKED_OUT])
@pytest.mark.parametrize("begins", ["track", "boot", "standby"])
@pytest.mark.parametrize("rate_hz", [20.0, 20 / 3])
def test_what_will_be_fired_is_known_ahead(faults: str, begins: str, rate_hz: float) -> None:
    """Up to the next command, here at 0.77 s: what was foretold is what is sent."""
    times = {"boot_s": 0.1, "self_test_s": 0.12, "acquisition_s": 0.2}
    session, constants = begun(faults, start=begins, after_boot="track", clock={"holdover_s": 2.1}, **times)
    foretold = firing(constants, initial(constants), 0, 50 * MS)
    early = [block for _ in range(16) if (block := session.shoot(1)) is not None]
    state = after(constants, (770, "set_mode", {"mode": "track"}), (775, "set_rate_hz", {"rate_hz": rate_hz}))
    if state is not None:
        session.use_device(state)
        foretold = [each for each in foretold if each[0] < 16]
        foretold += firing(constants, advance(constants, state, 800 * MS), 16, 50 * MS)
    sent = decoded(early + all_of(session))
    divisors = [max(each for each in foretold if each[0] <= shot)[1] for shot in range(80)]
    assert [shot for shot, divisor in enumerate(divisors) if divisor and shot % divisor == 0] == list(sent)


def test_beams_that_are_switched_off_do_not_fire() -> None:
    plain, (session, constants) = decoded(all_of(begun()[0])), begun()
    session.use_device(after(constants, (0, "enable_beams", {"beams": 0b1010})))
    sent = decoded(all_of(session))
    for shot, message in sent.items():
        assert [beam["fired"] for beam in message.beams] == [False, True, False, True]
        assert message.beams[1::2] == plain[shot].beams[1::2]
        assert message.beams[0]["range_m"] is None
        assert message.beams[0]["reason"] == Reason.NOT_FIRED
    blind = begun()[0].shoot(5, fired=False)
    assert blind is not None
    assert set(blind.measurement.reason.ravel()) == {Reason.NOT_FIRED}


@pytest.mark.parametrize(("settling_s", "unsettled"), [(0.0, 0), (0.001, 1), (0.1, 2), (0.12, 3)])
def test_beams_settle_after_a_change_of_pattern(settling_s: float, unsettled: int) -> None:
    session, constants = begun(settling_s=settling_s)
    session.shoot(10)
    session.use_device(after(constants, (480, "set_pattern", {"pattern": 1})))
    blocks = all_of(session, 3)
    fired = [bool(message.beams[0]["fired"]) for message in decoded(blocks).values()]
    assert fired == [False] * unsettled + [True] * (70 - unsettled)
    angles = [message.beams[0]["beam_angle_deg"] for message in decoded(blocks).values()]
    assert angles == [None] * unsettled + [7.5] * (70 - unsettled)


def test_the_scanner_s_own_switches_need_settling_too() -> None:
    switches = "[{kind: time, at_s: 0.3, pattern: {kind: square, angle_deg: 5}}]"
    options = {"level": "geometric", "site": "flat", "scanner.switches": switches}
    scenario = lidar_emu.load("descent.yaml", options)
    model = build_model(scenario)
    assert isinstance(model, FlightModel)
    constants = device_constants(DeviceBehaviour(settling_s=0.1), 20.0, 4, 2)
    block = Session(model, Encoder(scenario.wire, False, False, 4), 10, None, constants).shoot(12)
    assert block is not None
    assert block.measurement.fired[:, 0].tolist() == [True] * 6 + [False] * 2 + [True] * 4


def test_a_restart_counts_shots_anew() -> None:
    session, constants = begun(warm_restart_s=0.2, acquisition_s=0.0)
    session.shoot(20)
    session.use_device(
        after(constants, (990, "reset", {"restart": "warm"}), (1300, "set_mode", {"mode": "track"}))
    )
    sent = decoded(all_of(session))
    # Commanded at 1.3 s, which the state knows from the beginning: in a run the session learns of it in time.
    assert [message.shot for message in sent.values()] == list(range(len(sent)))
    assert next(iter(sent)) == 20


def test_times_in_packets_are_the_device_s_and_the_record_keeps_the_true_ones() -> None:
    session, _ = begun(clock={"offset_s": 100.25, "drift_ppm": 1000.0})
    plain, _ = begun()
    blocks, right = all_of(session), all_of(plain)
    for skewed, true in zip(decoded(blocks).values(), decoded(right).values(), strict=True):
        assert skewed.time_ns == pytest.approx(true.time_ns * 1.001 + 100.25e9, abs=200)
    assert blocks[0].measurement.time_ns.tolist() == right[0].measurement.time_ns.tolist()
    assert [block.due_ns for block in blocks] == [block.due_ns for block in right]


PARTS = st.fixed_dictionaries(
    {
        "start": st.sampled_from(["track", "boot", "standby"]),
        "boot_s": st.just(0.4),
        "self_test_s": st.just(0.21),
        "acquisition_s": st.sampled_from([0.0, 0.17]),
        "settling_s": st.sampled_from([0.0, 0.12]),
        "clock": st.sampled_from([{}, {"offset_s": 1.0, "drift_ppm": 50.0, "holdover_s": 0.9}]),
    }
)  # fmt: skip
STEPS = st.lists(st.integers(1, 25), min_size=80, max_size=80)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(PARTS, STEPS, st.sampled_from([1, 3]), st.sampled_from(["[]", FAULTS, OFF, LOCKED_OUT]))
def test_grouping_changes_no_packet(part: Any, steps: list[int], divisor: int, faults: str) -> None:
    def session() -> Session:
        made, _ = begun(faults, **part)
        state = made.device
        made.use_device(state._replace(settings=state.settings._replace(divisor=divisor, pattern=1)))
        return made

    one_by_one, grouped = session(), session()
    blocks = []
    for step in steps:
        if (block := grouped.shoot(step)) is not None:
            blocks.append(block)
    assert packets_of(blocks) == packets_of(all_of(one_by_one, 1))


@settings(max_examples=40, deadline=None)
@given(
    PARTS,
    st.lists(st.integers(0, 79), min_size=1, max_size=4),
    st.sampled_from([1, 3]),
    st.sampled_from(["[]", FAULTS, OFF, LOCKED_OUT]),
)
def test_going_back_gives_the_same_packets(part: Any, back: list[int], divisor: int, faults: str) -> None:
    session, _ = begun(faults, **part)
    state = session.device
    session.use_device(state._replace(settings=state.settings._replace(divisor=divisor)))
    whole = packets_of(all_of(session, 30))
    for shot in back:
        session.rewind(shot)
        assert session.next_shot == shot
        assert packets_of(all_of(session, 30)) == whole[shot:]


@pytest.mark.parametrize("steps", [[41, 80], [7, 8, 9, 30, 44, 80], list(range(1, 81))])
def test_shots_that_are_passed_over_are_counted_as_the_device_would_have_fired_them(steps: list[int]) -> None:
    """At a third of the rate, and off for a while, numbers after a stall are the same as without one."""
    faults = "[{kind: interlock, from_s: 1.3, to_s: 1.7}]"
    for part in ({"faults": faults}, {"start": "boot", "boot_s": 0.4, "self_test_s": 0.21}):
        session, whole = begun(**part)[0], begun(**part)[0]
        for each in (session, whole):
            settings_at_a_third = each.device.settings._replace(divisor=3)
            each.use_device(each.device._replace(settings=settings_at_a_third))
        all_of(whole)
        for step in steps:
            session.skip_to(step)
            assert session.next_shot == step
        assert _unnumbered(session) == _unnumbered(whole)


def _unnumbered(session: Session) -> int:
    return session._state.unnumbered


SILENT = [
    "{kind: stale_packet, from_s: 0.9, to_s: 1.7}",
    "{kind: garbage, bytes: 9}",
    "{kind: doubled}",
    "{kind: wrong_crc}",
    "{kind: bit_errors, rate: 0.01}",
    "{kind: frozen_counter, from_s: 0.9, to_s: 1.7}",
    "{kind: lost}",
    "{kind: time_jump, jump_s: 1}",
]


@pytest.mark.parametrize("fault", SILENT)
def test_faults_of_packets_find_nothing_to_act_on_where_none_is_sent(fault: str) -> None:
    session, _ = begun(f"[{fault}]", start="standby")
    blocks = all_of(session)
    assert set(packets_of(blocks)) == {b""}
    assert [block.faults for block in blocks] == [()] * len(blocks)


def test_what_repeats_the_last_packet_repeats_one_that_was_sent() -> None:
    """Standing by until 1 s; no packet and no number of then is repeated after."""
    for kind in ("stale_packet", "frozen_counter"):
        session, constants = begun(
            f"[{{kind: {kind}, from_s: 1.1, to_s: 1.15}}]", start="standby", acquisition_s=0.0
        )
        session.shoot(20)
        session.use_device(after(constants, (1000, "set_mode", {"mode": "track"})))
        session.shoot(1)
        silent = session.device._replace(mode=Mode.STANDBY, pending=())
        tracking = session.device
        session.use_device(silent)
        session.shoot(1)
        session.use_device(tracking)
        block = session.shoot(2)
        assert block is not None
        receiver = SerialReceiver(default_interface())
        messages = [message for packet in block.packets for message in receiver.receive(packet)]
        assert [message.shot for message in messages if isinstance(message, Message)] == [0, 2]
