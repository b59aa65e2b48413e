"""What sensors' clocks do wrong, as docs/faults.md states it: times on the wire against closed forms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import pytest

import lidar_emu
from lidar_emu.device.commands import DeviceCommand, execute
from lidar_emu.device.modes import advance, initial
from lidar_emu.device.state import events_of
from lidar_emu.errors import InputError
from lidar_emu.faults.packets import faulty_encoder
from lidar_emu.scenario.load import read_fault, shifted
from lidar_emu.session import Session
from lidar_emu.shots.model import build_model
from lidar_emu.wire import Encoder
from lidar_protocol import Message, SerialReceiver, default_interface

S = 10**9
STEP_NS = 60
"""Resolution of the time code, 2**-24 s."""
PERIOD_NS, SHOTS = S // 50, 100
WEEKS_NS = 1024 * 7 * 86400 * S


class Failure(NamedTuple):
    fault: dict[str, Any] | None
    stamp: Callable[[int], int]
    """What the clock reads at a true time, both in nanoseconds."""
    clock: dict[str, Any] = {}
    locks_ns: int = 0


def in_second_half(error_ns: int) -> Callable[[int], int]:
    return lambda t: t + error_ns if t // (S // 2) % 2 else t


FAILURES = {
    "leap seconds": Failure({"offset_s": 37}, lambda t: t + 37 * S),
    "dead master": Failure(
        {"drift_ppm": 500, "from_s": 0.5}, lambda t: t if t < S // 2 else t + (t - S // 2) // 2000
    ),
    "rounded seconds": Failure({"offset_s": 1, "second_half": True}, in_second_half(S)),
    "two references": Failure({"offset_s": 4.0e-5, "second_half": True}, in_second_half(40_000)),
    "weeks modulo 1024": Failure({"offset_s": 619315200}, lambda t: t + WEEKS_NS),
    "late lock": Failure(
        None, lambda t: t if t >= S else t + 1000 * S, {"lock_s": 1.0, "offset_s": 1000.0}, locks_ns=S
    ),
}


def received(blocks: list[Any]) -> list[Message]:
    receiver, found = SerialReceiver(default_interface()), list[Message]()
    for block in blocks:
        for packet in block.packets:
            found += [message for message in receiver.receive(packet) if isinstance(message, Message)]
    return found


def faults_of(failure: Failure) -> list[dict[str, Any]]:
    return [] if failure.fault is None else [{"kind": "clock_error", **failure.fault}]


@pytest.mark.parametrize("block_shots", [7, 128])
@pytest.mark.parametrize("name", FAILURES)
def test_times_on_the_wire_are_the_closed_form(bench: Any, shoot: Any, name: str, block_shots: int) -> None:
    failure = FAILURES[name]
    scenario = bench(*faults_of(failure), device={"clock": failure.clock})
    blocks = shoot(scenario, block_shots)
    messages, due = received(blocks), [due_ns for block in blocks for due_ns in block.due_ns]
    assert len(messages) == SHOTS
    for shot, (message, due_ns) in enumerate(zip(messages, due, strict=True)):
        valid_ns = shot * PERIOD_NS  # of a bench pattern: the beginning
        assert message.time_ns == pytest.approx(failure.stamp(valid_ns), abs=STEP_NS)
        assert message.header["clock_locked"] == (valid_ns >= failure.locks_ns)
        if valid_ns // (S // 2) == due_ns // (S // 2):  # what begins in between acts on the next shot
            assert message.due_ns == pytest.approx(failure.stamp(due_ns), abs=STEP_NS)


@pytest.mark.parametrize("name", FAILURES)
def test_housekeeping_and_acknowledgements_read_the_same_clock(
    bench: Any, device_constants_of: Any, name: str
) -> None:
    failure = FAILURES[name]
    scenario = bench(*faults_of(failure), device={"clock": failure.clock})
    constants = device_constants_of(scenario, build_model(scenario))
    for time_ns in range(0, 3 * S, 99_999_999):
        state = advance(constants, initial(constants), time_ns)
        assert state.clock.reads_ns(time_ns) == pytest.approx(failure.stamp(time_ns), abs=1)
        assert state.clock_locked == (time_ns >= failure.locks_ns)


def test_a_wrong_clock_ends_with_its_window_and_is_not_corrected_by_the_tone(
    bench: Any, device_constants_of: Any
) -> None:
    scenario = bench({"kind": "clock_error", "offset_s": 37, "from_s": 0.2, "to_s": 1.0})
    constants = device_constants_of(scenario, build_model(scenario))
    state = advance(constants, initial(constants), S // 2)
    tone = DeviceCommand("time_at_tone", {"tone_ns": 100 * S}, S // 2, S // 2)
    state, verdict = execute(constants, state, tone)
    assert (verdict, state.clock.reads_ns(S // 2)) == ("accepted", 137 * S)
    assert advance(constants, state, S).clock.reads_ns(S) == 100 * S + S // 2


def test_a_clock_locks_anew_after_a_brown_out(bench: Any, device_constants_of: Any) -> None:
    clock = {"lock_s": 0.5, "offset_s": 1000.0, "holdover_s": 0.6}
    brown_out = {"kind": "brown_out", "from_s": 0.7, "to_s": 0.8}
    scenario = bench(brown_out, device={"clock": clock})
    constants = device_constants_of(scenario, build_model(scenario))
    states = {ms: advance(constants, initial(constants), ms * 1_000_000) for ms in range(0, 2500, 100)}
    locked = [ms for ms, state in states.items() if state.clock_locked]
    assert locked == [500, 600, 700, *range(1300, 1900, 100)]
    assert states[1200].clock.reads_ns(1_200_000_000) == 1001_200_000_000
    assert states[2400].clock.reads_ns(2_400_000_000) == 2_400_000_000


def test_injected_in_flight_it_is_as_if_the_scenario_had_it(bench: Any, device_constants_of: Any) -> None:
    def session(scenario: Any) -> Session:
        model, encoder = build_model(scenario), Encoder(scenario.wire, False, False, 4)
        faulty = faulty_encoder(scenario, encoder, False)
        return Session(model, encoder, 10, faulty, device_constants_of(scenario, model))

    flown = session(bench())
    blocks = [flown.shoot(20)]
    fault = shifted(read_fault("{kind: clock_error, drift_ppm: 100, to_s: 0.5}"), 0.4)
    scenario = bench().model_copy(update={"faults": [fault]})
    encoder = Encoder(scenario.wire, False, False, 4)
    events = events_of(scenario.faults)
    flown.use_faults(build_model(scenario), faulty_encoder(scenario, encoder, False), events)
    planned = session(scenario)
    again = []
    for each, into in ((flown, blocks), (planned, again)):
        while (block := each.shoot(128)) is not None:
            into.append(block)
    sent = [[packet for block in run for packet in block.packets] for run in (blocks, again)]
    assert sent[0] == sent[1]
    assert received(again)[44].time_ns == pytest.approx(880_048_000, abs=STEP_NS)


def test_beams_keep_their_offsets_across_the_half_second(device_constants_of: Any) -> None:
    """Beams of a scanner are valid one after another: the header's time steps, their offsets do not."""
    faults = {"faults": "[{kind: clock_error, offset_s: 1, second_half: on}]"}
    keys = {"site": "flat", "timing.rate_hz": "16.03", "duration_s": "2", "scanner.firing": "in_turn"}
    offsets, times_ns = [], []
    for changed in ({}, faults):
        scenario = lidar_emu.load("descent.yaml", {**keys, **changed})
        model = build_model(scenario)
        encoder = Encoder(scenario.wire, False, False, model.beam_count)
        faulty, constants = faulty_encoder(scenario, encoder, False), device_constants_of(scenario, model)
        session = Session(model, encoder, 1, faulty, constants)
        messages = received([session.shoot(32)])
        offsets.append([[beam["time_offset_s"] for beam in each.beams] for each in messages])
        times_ns.append([each.time_ns for each in messages])
    assert offsets[0] == offsets[1]
    steps = [later - earlier for earlier, later in zip(*times_ns, strict=True)]
    assert steps == [in_second_half(S)(t) - t for t in times_ns[0]]
    crossed = [
        t // (S // 2)
        for t, each in zip(times_ns[0], offsets[0], strict=True)
        if (t + round(each[-1] * 1e9)) // (S // 2) != t // (S // 2)
    ]
    assert crossed == [0, 1, 2], "headers on one side, beams on the other"


@pytest.mark.parametrize(
    "fault", ["{kind: clock_error}", "{kind: clock_error, offset_s: 2.0e+9}", "{kind: clock_error, at_s: 1}"]
)
def test_what_cannot_be_is_refused(fault: str) -> None:
    with pytest.raises(InputError, match=r"offset_s|at_s"):
        lidar_emu.load("bench.yaml", {"faults": f"[{fault}]"})
