"""What happens to the device on order: mode, numbers, housekeeping and shots agree, ordered before the run or in it."""

from __future__ import annotations

from typing import Any

import pytest

import lidar_emu
from lidar_emu.device.commands import DeviceCommand, DeviceTimeline
from lidar_emu.device.modes import initial
from lidar_emu.device.state import DeviceConstants, events_of
from lidar_emu.errors import InputError
from lidar_emu.faults.packets import faulty_encoder
from lidar_emu.scenario.load import read_fault, shifted
from lidar_emu.session import Block, Session
from lidar_emu.shots.model import build_model
from lidar_emu.wire import Encoder
from lidar_protocol import Message, SerialReceiver, default_interface

MS, PERIOD_NS = 1_000_000, 20_000_000
FIRST, END, SHOTS = 20, 30, 100
QUICK = {"device": {"boot_s": 0.1, "self_test_s": 0.06, "acquisition_s": 0.04}}


def begun(bench: Any, device_constants_of: Any, *faults: dict[str, Any]) -> tuple[Session, DeviceTimeline]:
    scenario = bench(*faults, **QUICK)
    model = build_model(scenario)
    encoder, constants = Encoder(scenario.wire, False, False, 4), device_constants_of(scenario, model)
    session = Session(model, encoder, 10, faulty_encoder(scenario, encoder, False), constants)
    return session, DeviceTimeline(constants, initial(constants))


def ordered(session: Session, device: DeviceTimeline, scenario: Any, text: str) -> Any:
    """The scenario with a fault that comes in flight."""
    fault = shifted(read_fault(text), session.next_shot * PERIOD_NS * 1e-9)
    scenario = scenario.model_copy(update={"faults": [*scenario.faults, fault]})
    events = events_of(scenario.faults)
    encoder = Encoder(scenario.wire, False, False, 4)
    session.use_faults(build_model(scenario), faulty_encoder(scenario, encoder, False), events)
    device.use_events(events)
    return scenario


def command(session: Session, device: DeviceTimeline, at_ms: int, name: str, **values: Any) -> str:
    state, verdict = device.execute(DeviceCommand(name, values, at_ms * MS, at_ms * MS))
    if state is not None:
        session.use_device(state)
    return verdict


def numbers(blocks: list[Block]) -> dict[int, int]:
    """What was sent: the device's number of each shot by the scenario's."""
    receiver, found = SerialReceiver(default_interface()), dict[int, int]()
    for block in blocks:
        for shot, packet in zip(block.measurement.shot.tolist(), block.packets, strict=True):
            for message in receiver.receive(packet):
                assert isinstance(message, Message)
                assert message.shot is not None
                found[shot] = message.shot
    return found


def up_to(session: Session, shot: int) -> list[Block]:
    blocks = []
    while session.next_shot < shot:
        block = session.shoot(shot - session.next_shot)
        assert block is not None
        blocks.append(block)
    return blocks


def test_after_a_brown_out_the_device_boots_and_begins_anew(bench: Any, device_constants_of: Any) -> None:
    """Off from 0.4 to 0.6 s, boot until 0.7, self-test until 0.76, then by command; shot 40 is the first after it."""
    session, device = begun(bench, device_constants_of, {"kind": "brown_out", "from_s": 0.4, "to_s": 0.6})
    modes = {ms: str(device.at(ms * MS).mode) for ms in (399, 400, 599, 600, 700, 760)}
    assert list(modes.values()) == ["track", "off", "off", "boot", "self_test", "standby"]
    assert device.at(800 * MS).restarted_ns == 600 * MS
    blocks = up_to(session, 40)
    assert command(session, device, 590, "no_op") == "out_of_state"
    assert command(session, device, 790, "set_mode", mode="track") == "accepted"
    blocks += up_to(session, SHOTS)
    expected = {k: k for k in range(FIRST)} | {k: k - 40 for k in range(40, SHOTS)}
    assert numbers(blocks) == expected
    reported = [(fault.shot, fault.kind) for block in blocks for fault in block.faults]
    assert reported == [(k, "brown_out") for k in range(FIRST, END)]


def test_an_open_interlock_is_mode_fault_until_a_reset(bench: Any, device_constants_of: Any) -> None:
    session, device = begun(bench, device_constants_of, {"kind": "interlock", "from_s": 0.4, "to_s": 0.6})
    blocks = up_to(session, 25)
    assert command(session, device, 500, "set_mode", mode="track") == "out_of_state"
    blocks += up_to(session, 50)
    state = device.at(1000 * MS)
    assert (state.mode, state.interlock_closed) == ("fault", True)
    assert not device.at(599 * MS).interlock_closed
    assert sorted(numbers(blocks)) == list(range(FIRST))
    assert command(session, device, 1000, "reset", restart="cold") == "accepted"
    assert device.at(1161 * MS).mode == "standby"


@pytest.mark.parametrize("kind", ["brown_out", "interlock"])
@pytest.mark.parametrize("ahead", [0, 1, 40])
def test_ordered_in_flight_it_is_as_if_the_scenario_had_it(
    bench: Any, device_constants_of: Any, kind: str, ahead: int
) -> None:
    """Also where shots had been computed ahead, and a command waits that was heard before the fault was known."""
    session, device = begun(bench, device_constants_of)
    blocks = up_to(session, FIRST)
    up_to(session, FIRST + ahead)
    state, _ = device.execute(DeviceCommand("enable_beams", {"beams": 7}, 390 * MS, 390 * MS))
    assert state is not None
    if ahead:
        session.rewind(FIRST)
    scenario = ordered(session, device, bench(**QUICK), f"{{kind: {kind}, from_s: 0.1, to_s: 0.3}}")
    session.use_device(state)
    blocks += up_to(session, SHOTS)
    planned, now = begun(
        bench, device_constants_of, *(fault.model_dump(mode="json") for fault in scenario.faults)
    )
    again = up_to(planned, FIRST)
    command(planned, now, 390, "enable_beams", beams=7)
    again += up_to(planned, SHOTS)
    assert [packet for block in blocks for packet in block.packets] == [
        packet for block in again for packet in block.packets
    ]
    assert [device.at(ms * MS) for ms in range(400, 2000, 50)] == [
        now.at(ms * MS) for ms in range(400, 2000, 50)
    ]
    assert sorted(numbers(blocks)) == list(range(FIRST + 5))


def test_events_of_several_faults_are_in_order(bench: Any, device_constants_of: Any) -> None:
    scenario = bench({"kind": "brown_out", "from_s": 1.0, "to_s": 2.0}, {"kind": "interlock", "from_s": 0.5})
    constants: DeviceConstants = device_constants_of(scenario, build_model(scenario))
    assert [(event.at_ns // MS, event.what) for event in constants.events] == [
        (500, "interlock_opens"),
        (1000, "power_off"),
        (2000, "power_on"),
    ]


def test_by_chance_nothing_happens_to_the_device() -> None:
    with pytest.raises(InputError, match="probability"):
        lidar_emu.load("bench.yaml", {"faults": "[{kind: brown_out, probability: 0.1}]"})
