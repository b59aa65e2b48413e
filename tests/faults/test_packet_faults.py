"""What each fault of packets, stamps and the link makes of the bytes, and what a receiver sees of it."""

from __future__ import annotations

import binascii
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lidar_emu.errors import InputError
from lidar_emu.faults.packets import FaultyEncoder
from lidar_emu.session import Block
from lidar_emu.shots.model import build_model
from lidar_emu.wire import Encoder
from lidar_protocol import SerialReceiver, cobs, shipped_interface

WINDOW = {"from_s": 0.4, "to_s": 0.6}
FIRST, END, SHOTS = 20, 30, 100


def packets(blocks: list[Block]) -> list[Any]:
    return [packet for block in blocks for packet in block.packets]


def dues(blocks: list[Block]) -> list[int]:
    return [due for block in blocks for due in block.due_ns]


@pytest.fixture
def sent(bench: Any, shoot: Any) -> Any:
    """The packets of the pattern with and without a fault in the window; outside they are the same."""

    def run(can: bool = False, **fault: Any) -> tuple[list[Any], list[Any]]:
        good, bad = shoot(bench(), can=can), shoot(bench({**WINDOW, **fault}), can=can)
        for block, faulty in zip(good, bad, strict=True):
            for name in ("range_m", "closing_speed_mps", "time_ns", "shot", "due_ns"):
                a, b = getattr(block.measurement, name), getattr(faulty.measurement, name)
                np.testing.assert_array_equal(a, b)
        before, after = packets(good), packets(bad)
        assert len(after) == SHOTS
        assert (before[:FIRST], before[END + 1 :]) == (after[:FIRST], after[END + 1 :])
        return before, after

    return run


def received(stream: bytes, interface: str = "default") -> SerialReceiver:
    receiver = SerialReceiver(shipped_interface(interface))
    receiver.receive(stream)
    return receiver


@pytest.mark.parametrize("kind", ["lost", "silence"])
@pytest.mark.parametrize("can", [False, True])
def test_nothing_is_sent(sent: Any, kind: str, can: bool) -> None:
    good, bad = sent(kind=kind, can=can)
    assert bad[FIRST:END] == [[] if can else b""] * 10
    assert bad[END] == good[END]
    if not can:
        assert received(b"".join(bad)).counters.lost_packets == 10


@pytest.mark.parametrize("can", [False, True])
def test_doubled(sent: Any, can: bool) -> None:
    good, bad = sent(kind="doubled", can=can)
    assert bad[FIRST:END] == [packet * 2 for packet in good[FIRST:END]]
    if not can:
        assert received(b"".join(bad)).counters.restarts == 10


@pytest.mark.parametrize("can", [False, True])
def test_reordered_throughout_a_window_swaps_pairs(sent: Any, can: bool) -> None:
    good, bad = sent(kind="reordered", can=can)
    for shot in range(FIRST, END, 2):
        assert bad[shot : shot + 2] == [[] if can else b"", good[shot + 1] + good[shot]]


def test_stale_packet(sent: Any) -> None:
    good, bad = sent(kind="stale_packet")
    assert bad[FIRST:END] == [good[FIRST - 1]] * 10


def test_stale_from_the_start_is_what_there_is(bench: Any, shoot: Any) -> None:
    good, bad = (packets(shoot(scenario)) for scenario in (bench(), bench({"kind": "stale_packet"})))
    assert bad == good[:1] * SHOTS


@pytest.mark.parametrize("can", [False, True])
def test_bit_errors_come_at_their_rate(bench: Any, shoot: Any, can: bool) -> None:
    rate, wrong, bits = 0.02, 0, 0
    good, bad = (
        packets(shoot(bench(*faults), can=can)) for faults in ((), ({"kind": "bit_errors", "rate": rate},))
    )
    for before, after in zip(good, bad, strict=True):
        if can:
            assert [frame._replace(data=b"") for frame in before] == [f._replace(data=b"") for f in after]
            before, after = (b"".join(frame.data for frame in frames) for frames in (before, after))
        assert len(before) == len(after)
        wrong += sum((a ^ b).bit_count() for a, b in zip(before, after, strict=True))
        bits += 8 * len(before)
    assert wrong == pytest.approx(rate * bits, abs=5 * np.sqrt(rate * bits))


@pytest.mark.parametrize("can", [False, True])
def test_bit_errors_are_reported_of_the_packets_that_they_hit(bench: Any, shoot: Any, can: bool) -> None:
    good = packets(shoot(bench(), can=can))
    blocks = shoot(bench({"kind": "bit_errors", "rate": 2e-4}), can=can)
    hit = {shot for shot, (a, b) in enumerate(zip(good, packets(blocks), strict=True)) if a != b}
    assert 5 < len(hit) < 50
    assert {fault.shot for block in blocks for fault in block.faults} == hit


def test_every_bit_is_wrong_at_rate_one(sent: Any) -> None:
    good, bad = sent(kind="bit_errors", rate=1.0)
    assert [bytes(byte ^ 0xFF for byte in packet) for packet in bad[FIRST:END]] == good[FIRST:END]


def test_truncated(sent: Any) -> None:
    good, bad = sent(kind="truncated", keep=0.3)
    assert bad[FIRST:END] == [packet[: int(0.3 * len(packet))] for packet in good[FIRST:END]]
    assert received(b"".join(bad)).counters.messages == 90, "each costs itself alone"
    good, bad = sent(kind="truncated", keep=0.3, can=True)
    assert bad[FIRST:END] == [frames[: int(0.3 * len(frames))] for frames in good[FIRST:END]]
    assert all(bad[FIRST:END])


@pytest.mark.parametrize("interface", ["default", "altimeter"])
def test_wrong_crc(bench: Any, shoot: Any, interface: str) -> None:
    """The altimeter's frames begin with a sync word and end with a CRC."""
    scenario = bench({"kind": "wrong_crc", **WINDOW}, wire={"interface": interface})
    counters = received(b"".join(packets(shoot(scenario))), interface).counters
    assert (counters.bad_crc, counters.messages, counters.bad_stuffing, counters.bad_length) == (10, 90, 0, 0)


def test_delayed_packets_keep_their_order_and_contents(bench: Any, shoot: Any) -> None:
    fault = {"kind": "delayed", "delay_s": 0.07, **WINDOW}
    good, bad = shoot(bench(), 7), shoot(bench(fault), 7)
    assert packets(good) == packets(bad)
    before, after = dues(good), dues(bad)
    assert after == sorted(after)
    assert [b - a for a, b in zip(before[FIRST:END], after[FIRST:END], strict=True)] == [70_000_000] * 10
    # The next ones wait for the last delayed one: 70 ms after shot 29, which are shots 30 to 32 (20 ms apart).
    assert after[END : END + 3] == [before[END - 1] + 70_000_000] * 3
    assert after[:FIRST] + after[END + 3 :] == before[:FIRST] + before[END + 3 :]


def test_garbage(sent: Any) -> None:
    good, bad = sent(kind="garbage", bytes=50)
    noise = [packet[:50] for packet in bad[FIRST:END]]
    assert [packet[50:] for packet in bad[FIRST:END]] == good[FIRST:END]
    assert len(set(noise)) == 10
    assert len(set(b"".join(noise))) > 150
    assert received(b"".join(bad)).counters.messages == 100, "costs no packet"
    good, bad = sent(kind="garbage", bytes=50, can=True)
    assert [frames[7:] for frames in bad[FIRST:END]] == good[FIRST:END]
    for frames in bad[FIRST:END]:
        assert [len(frame.data) for frame in frames[:7]] == [8] * 6 + [2]
        assert all(0 <= frame.can_id < 0x800 for frame in frames[:7])


def test_garbage_on_a_silent_line(bench: Any, shoot: Any) -> None:
    faults = {"kind": "silence"}, {"kind": "garbage", "bytes": 10}
    assert {len(packet) for packet in packets(shoot(bench(*faults)))} == {10}
    assert {len(packet) for packet in packets(shoot(bench(*faults), can=True))} == {2}
    assert set(packets(shoot(bench(*reversed(faults))))) == {b""}


def messages(stream: list[bytes]) -> list[Any]:
    return SerialReceiver(shipped_interface("default")).receive(b"".join(stream))


def test_time_jump(sent: Any) -> None:
    good, bad = (messages(stream) for stream in sent(kind="time_jump", jump_s=5.0))
    for shot, (before, after) in enumerate(zip(good, bad, strict=True)):
        jump_ns = 5_000_000_000 if FIRST <= shot < END else 0
        # To the resolution of the packet's time code.
        assert after.time_ns - before.time_ns == pytest.approx(jump_ns, abs=100_000)
        assert after.due_ns == before.due_ns
        assert after.beams == before.beams


def test_time_stops_at_the_epoch(sent: Any) -> None:
    _, bad = sent(kind="time_jump", jump_s=-100.0)
    assert {message.time_ns for message in messages(bad)[FIRST:END]} == {0}


def test_frozen_counter(sent: Any) -> None:
    good, bad = (messages(stream) for stream in sent(kind="frozen_counter"))
    assert [m.sequence for m in bad] == [*range(FIRST), *[FIRST - 1] * 10, *range(END, SHOTS)]
    assert [m.beams for m in bad] == [m.beams for m in good]


def test_wrong_unit(sent: Any) -> None:
    good, bad = (messages(stream) for stream in sent(kind="wrong_unit"))
    for shot, (before, after) in enumerate(zip(good, bad, strict=True)):
        feet = 1 / 0.3048 if FIRST <= shot < END else 1
        for a, b in zip(before.beams[:3], after.beams[:3], strict=True):
            assert b["range_m"] == pytest.approx(feet * a["range_m"], abs=2e-3)
            assert b["closing_speed_mps"] == pytest.approx(feet * a["closing_speed_mps"], abs=2e-4)
            assert b["snr_db"] == a["snr_db"]


def unframed(packet: bytes) -> bytes:
    return cobs.decode(packet.strip(b"\0"))


def body_of(packet: bytes) -> bytes:
    """Body of a space packet; checks its CRC."""
    data = unframed(packet)
    assert binascii.crc_hqx(data[:-2], 0xFFFF) == int.from_bytes(data[-2:], "big")
    return data[6:-2]


def test_other_unit(sent: Any) -> None:
    good, bad = sent(kind="other_unit", unit=5)
    for before, after in zip(good[FIRST:END], bad[FIRST:END], strict=True):
        assert int.from_bytes(unframed(after)[:2], "big") & 0x7FF == 0x2A0 + 5
        assert unframed(after)[2:6] == unframed(before)[2:6]
        assert body_of(after) == body_of(before)
    good, bad = sent(kind="other_unit", unit=5, can=True)
    for before, after in zip(good[FIRST:END], bad[FIRST:END], strict=True):
        assert [frame._replace(can_id=frame.can_id - 5 * 0x40) for frame in after] == before


def test_wrong_endian(sent: Any) -> None:
    header = ">7s7sBBBB4sB"
    beam = ">BB2s4s4s4s2s2s2s2s4s2sB"
    good, bad = sent(kind="wrong_endian")
    for before, after in zip(good[FIRST:END], bad[FIRST:END], strict=True):
        one, other = body_of(before), body_of(after)
        assert len(one) == len(other) == struct.calcsize(header) + 4 * struct.calcsize(beam)
        beams = [(beam, struct.calcsize(header) + k * struct.calcsize(beam)) for k in range(4)]
        for layout, start in [(header, 0), *beams]:
            for a, b in zip(
                struct.unpack_from(layout, one, start), struct.unpack_from(layout, other, start), strict=True
            ):
                assert b == (a[::-1] if isinstance(a, bytes) else a)
    assert not received(b"".join(bad)).counters.bad_crc
    good, bad = sent(kind="wrong_endian", can=True)
    for before, after in zip(good[FIRST:END], bad[FIRST:END], strict=True):
        assert [(frame.can_id, len(frame.data)) for frame in after] == [
            (f.can_id, len(f.data)) for f in before
        ]
        assert all(sorted(a.data) == sorted(b.data) for a, b in zip(before, after, strict=True))
        assert before != after


@pytest.mark.parametrize("interface", ["default", "altimeter"])
def test_wrong_endian_twice_is_right(bench: Any, shoot: Any, interface: str) -> None:
    keys = {"wire": {"interface": interface}}
    good = packets(shoot(bench(**keys)))
    once, twice = (packets(shoot(bench(*[{"kind": "wrong_endian"}] * n, **keys))) for n in (1, 2))
    assert good == twice
    assert all(a != b for a, b in zip(good, once, strict=True))


def test_other_version(sent: Any) -> None:
    good, bad = sent(kind="other_version", version=9)
    for before, after in zip(good[FIRST:END], bad[FIRST:END], strict=True):
        assert (body_of(before)[14], body_of(after)[14]) == (3, 9)
        assert body_of(before)[:14] + body_of(before)[15:] == body_of(after)[:14] + body_of(after)[15:]
    counters = received(b"".join(bad)).counters
    assert (counters.foreign, counters.messages) == (10, 90)


@pytest.mark.parametrize(
    ("fault", "interface", "reported"),
    [
        ({"kind": "other_unit", "unit": 4}, "altimeter", "use units 0 to 3 of the interface"),
        (
            {"kind": "other_version", "version": 2},
            "altimeter",
            "use an interface that sends interface_version",
        ),
    ],
)
def test_what_an_interface_does_not_say_is_refused(
    bench: Any, fault: Any, interface: str, reported: str
) -> None:
    scenario = bench(fault, wire={"interface": interface})
    with pytest.raises(InputError, match=reported):
        FaultyEncoder(scenario, Encoder(scenario.wire, False, False, 4), False)


def test_a_crc_that_there_is_not_is_refused(bench: Any) -> None:
    scenario = bench({"kind": "wrong_crc"})
    encoder = Encoder(scenario.wire, True, False, 4)
    with pytest.raises(InputError, match=r"faults\.0\.kind: wrong_crc on CAN; use a byte link"):
        FaultyEncoder(scenario, encoder, True)


def test_packets_that_double_without_measure_are_refused(bench: Any) -> None:
    scenario = bench(*[{"kind": "doubled"}] * 7)
    with pytest.raises(InputError, match="faults: 7 of kind doubled or reordered; must be 6"):
        FaultyEncoder(scenario, Encoder(scenario.wire, False, False, 4), False)


PACKET_FAULTS = st.sampled_from(
    [
        *(
            {"kind": kind}
            for kind in ("lost", "doubled", "reordered", "stale_packet", "truncated", "wrong_crc")
        ),
        *({"kind": kind} for kind in ("frozen_counter", "wrong_endian", "wrong_unit")),
        {"kind": "bit_errors", "rate": 0.01},
        {"kind": "delayed", "delay_s": 0.05},
        {"kind": "garbage", "bytes": 30},
        {"kind": "time_jump", "jump_s": 1.0},
        {"kind": "other_unit", "unit": 3},
        {"kind": "other_version", "version": 7},
    ]
)


@given(faults=st.lists(PACKET_FAULTS, min_size=1, max_size=5), fd=st.booleans(), can=st.booleans())
@settings(deadline=None, max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_packet_is_longer_than_was_reported(
    bench: Any, shoot: Any, faults: list[Any], fd: bool, can: bool
) -> None:
    from lidar_emu.runtime.port.packets import payload_of

    faults = [fault for fault in faults if not (can and fault["kind"] == "wrong_crc")]
    scenario = bench(*({**fault, "probability": 0.7} for fault in faults))
    encoder = Encoder(scenario.wire, can, fd, 4)
    plain = max(len(payload_of(p)) for p in packets(shoot(bench(), can=can, fd=fd)))
    longest = FaultyEncoder(scenario, encoder, can).longest(plain)
    stuffing = 4 * len(faults)  # a packet with another time or count may need a few more bytes
    assert max(len(payload_of(p)) for p in packets(shoot(scenario, can=can, fd=fd))) <= longest + stuffing
    assert build_model(scenario).faults is None
