"""Counters and times where their fields are full: bytes against the layout in INTERFACE.md, and both receivers."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidar_emu.embedded_device import EmbeddedDevice
from lidar_emu.scenario.load import load
from lidar_emu.session import Session
from lidar_emu.shots.model import build_model
from lidar_emu.wire import Encoder, Packet
from lidar_protocol import (
    Acknowledge,
    CanFrame,
    CanReceiver,
    Device,
    Host,
    Housekeeping,
    Message,
    SerialReceiver,
    cobs,
    default_interface,
)

PERIOD_NS = 1_000_000
LONG = {"timing.rate_hz": "1000", "bench_pattern.duration_s": "4500000"}
"""4.5e9 shots, of which few are computed."""
LAST_TICK = 2**56 - 1


def unstuffed(frame: bytes) -> bytes:
    return cobs.decode(frame.strip(b"\0"))


def ticks(time_ns: int) -> int:
    """Section 1: steps of 2**-24 s, halves up."""
    return int(Fraction(time_ns * 2**24, 10**9) + Fraction(1, 2))


def packets(first: int, count: int, link: str) -> list[Packet]:
    """Packets of consecutive shots on a link: `serial`, or a set of messages on CAN."""
    scenario = load("bench.yaml", LONG | ({"wire.can_messages": link} if link in ("core", "full") else {}))
    model = build_model(scenario)
    session = Session(model, Encoder(scenario.wire, link != "serial", link == "fd", model.beam_count))
    session.skip_to(first)
    block = session.shoot(count)
    assert block is not None
    return block.packets


@given(st.sampled_from([2**8, 2**14, 2**16, 2**24, 2**31, 2**32]), st.integers(-3, 3))
def test_a_packet_has_the_lowest_bits_of_the_shot_and_its_time(power: int, beyond: int) -> None:
    shot = power + beyond
    (framed,) = packets(shot, 1, "serial")
    assert isinstance(framed, bytes)
    packet = unstuffed(framed)
    assert int.from_bytes(packet[2:4], "big") == 0xC000 + shot % 2**14
    assert int.from_bytes(packet[24:28], "big") == shot % 2**32
    assert int.from_bytes(packet[6:13], "big") == ticks(shot * PERIOD_NS)


@pytest.mark.parametrize("power", [2**14, 2**32])
@pytest.mark.parametrize("link", ["serial", "core", "full", "fd"])
def test_a_receiver_counts_no_gap_where_the_counter_starts_anew(power: int, link: str) -> None:
    serial, can = SerialReceiver(default_interface()), CanReceiver(default_interface())
    messages = []
    for packet in packets(power - 20, 40, link):
        if isinstance(packet, bytes):
            messages += serial.receive(packet)
        else:
            messages += [
                each for frame in packet for each in can.receive(frame.can_id, frame.data, frame.is_fd)
            ]
    assert len(messages) == 40
    if link != "core":
        assert [each.shot for each in messages if isinstance(each, Message)] == [
            shot % 2**32 for shot in range(power - 20, power + 20)
        ]
    assert serial.counters.sequence_gaps == serial.counters.restarts == serial.counters.lost_packets == 0
    assert can.counters.sequence_gaps == can.counters.incomplete == can.counters.orphans == 0


def test_can_counts_shots_modulo_16() -> None:
    for shot, frames in zip(range(2**32 - 3, 2**32 + 3), packets(2**32 - 3, 6, "fd"), strict=True):
        header, *_ = frames
        assert isinstance(header, CanFrame)
        assert header.data[0] >> 4 == shot % 16
        assert int.from_bytes(header.data[19:23], "big") == shot % 2**32


def test_answers_are_counted_modulo_2_to_the_14() -> None:
    device, receiver = Device(default_interface()), SerialReceiver(default_interface())
    for number in (2**14 - 1, 2**14, 2**14 + 1):
        answer = device.acknowledge(number, "no_op", sequence=0, verdict="accepted", time_ns=0)
        assert int.from_bytes(unstuffed(answer)[2:4], "big") == 0xC000 + number % 2**14
        assert len(receiver.receive(answer)) == 1
    assert receiver.counters.sequence_gaps == 0


def flown(keys: dict[str, str], tone_ns: int, at_ns: int) -> tuple[str, np.ndarray]:
    """Verdict on a time at the tone, and the times of the following packets in ticks."""
    device, receiver = EmbeddedDevice("bench.yaml", keys), SerialReceiver(default_interface())
    device.advance(at_ns)
    command = Host(default_interface()).encode_command("time_at_tone", sequence=0, tone_ns=tone_ns)
    (answer,) = receiver.receive(device.receive(command, at_ns)[0].payload)
    assert isinstance(answer, Acknowledge)
    sent = device.advance(21 * 10**9)
    times = [int.from_bytes(unstuffed(each.payload)[6:13], "big") for each in sent if each.kind == "shot"]
    assert len(times) >= 199
    assert all(isinstance(each, Message | Housekeeping) for p in sent for each in receiver.receive(p.payload))
    return str(answer.verdict), np.array(times[1:], dtype=np.uint64)


@pytest.mark.parametrize("seconds", [86_400, 366 * 86_400, 2**24, 2**31])
def test_days_years_and_bytes_of_seconds_roll_over(seconds: int) -> None:
    """Set ten seconds before, the clock runs through: 0.1 s from packet to packet."""
    verdict, times = flown({}, (seconds - 10) * 10**9, 10**8)
    assert verdict == "accepted"
    assert times[0] < seconds * 2**24 < times[-1]
    assert set(np.diff(times).tolist()) <= {1_677_721, 1_677_722}


@pytest.mark.parametrize(
    "keys",
    [{"device.clock.drift_ppm": "10000"}, {"faults": "[{kind: time_jump, jump_s: 100, from_s: 5}]"}],
    ids=["a fast clock", "a jump"],
)
def test_a_clock_at_its_end_is_held_and_ends_no_run(keys: dict[str, str]) -> None:
    """A host may set it so late that only its error, or a fault, carries it beyond 2**32 s."""
    verdict, times = flown(keys, (2**32 * 100 - 2005) * 10**7, 10**7)
    assert verdict == "accepted"
    assert (np.diff(times.astype(np.int64)) >= 0).all()
    assert times[-1] == LAST_TICK
