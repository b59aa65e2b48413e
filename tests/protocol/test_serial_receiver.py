"""The host's side of a byte link: portions, garbage, damage, gaps."""

import binascii
import struct
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidar_icd import example
from lidar_protocol import Device, EncodeError, SerialReceiver, cobs, default_interface, load, packet
from lidar_protocol.definition_file import files

INTERFACE = default_interface()
DEFAULT = (files("lidar_protocol") / "default.toml").read_text(encoding="utf-8")
FULL_BEAMS = [example.BEAMS[0]] * 64


def sealed(apid, count, body):
    """A telemetry packet with a secondary header."""
    head = struct.pack(">HHH", 0x0800 | apid, 0xC000 | count, len(body) + 1) + body
    return head + struct.pack(">H", binascii.crc_hqx(head, 0xFFFF))


def frame(shot, unit=0):
    return Device(INTERFACE, unit).serial_bytes({**example.HEADER, "shot": shot}, example.BEAMS)


def shots(messages):
    return [message.shot for message in messages]


@given(st.binary(max_size=300), st.binary(max_size=300), st.lists(st.integers(0, 900), max_size=6))
def test_packets_after_garbage_are_read_however_the_bytes_are_cut(before, after, cuts):
    stream = before + b"\0" + frame(7) + frame(8) + after + b"\0" + frame(9)
    receiver = SerialReceiver(INTERFACE)
    edges = [0, *sorted(cuts), len(stream)]
    messages = []
    for start, end in pairwise(edges):
        messages += receiver.receive(stream[start:end])
    assert shots(messages)[:2] == [7, 8]
    assert shots(messages)[-1] == 9
    used = sum(len(frame(shot).strip(b"\0")) for shot in (7, 8, 9))
    assert receiver.counters.skipped_bytes == len(stream) - used - stream.count(0)


def test_a_frame_without_its_end_costs_itself_alone():
    receiver = SerialReceiver(INTERFACE)
    assert shots(receiver.receive(frame(0)[:70] + frame(1) + frame(2))) == [1, 2]


@pytest.mark.parametrize("before", [b"\xaa", b"\xaa\xaa\xaa\x00\x01", b"\xaa\xaa\x00\x05\xaa\xaa\xaa"])
def test_a_sync_word_that_begins_within_a_coincidental_one_is_found(before):
    framing = 'kind = "sync"\nsync = "AAAA"\nlength = "u16"'
    interface = load(DEFAULT.replace('kind = "cobs"', framing, 1), "mine.toml")
    device = Device(interface, 0)
    frames = [device.serial_bytes({**example.HEADER, "shot": shot}, example.BEAMS) for shot in (1, 2)]
    receiver = SerialReceiver(interface)
    assert shots(receiver.receive(before.join([b"", *frames, bytes(3000)]))) == [1, 2]
    assert receiver.counters.skipped_bytes >= 2 * len(before)


def test_joining_in_the_middle_of_a_frame_is_no_gap():
    receiver = SerialReceiver(INTERFACE)
    assert shots(receiver.receive(frame(41)[50:] + frame(42) + frame(43))) == [42, 43]
    assert receiver.counters.sequence_gaps == receiver.counters.lost_packets == 0


def test_each_kind_of_bad_frame_has_its_counter():
    plain = packet.encode(INTERFACE, 0, example.HEADER, example.BEAMS)
    body = plain[6:-2]
    wrong_version = body[:14] + b"\x63" + body[15:]
    wrong_count = body[:17] + b"\x05" + body[18:]
    receiver = SerialReceiver(INTERFACE)
    for bad in (
        b"\x09\x01\x01",  # ends inside a run
        cobs.encode(plain[:-1]),
        cobs.encode(plain[:-1] + bytes((plain[-1] ^ 1,))),
        cobs.encode(sealed(0x123, 0, body)),
        cobs.encode(sealed(0x2A0, 0, wrong_version)),
        cobs.encode(sealed(0x2A0, 0, wrong_count)),
        b"\x01" * 5000,
        b"",
    ):
        assert receiver.receive(bad + b"\0") == []
    counters = receiver.counters
    found = (counters.frames, counters.bad_stuffing, counters.bad_length, counters.bad_crc, counters.foreign)
    assert found == (7, 1, 3, 1, 2)
    assert counters.messages == 0


def test_gaps_restarts_and_units_are_distinguished():
    receiver = SerialReceiver(INTERFACE)
    for data in (
        frame(10),
        frame(11),
        frame(500, unit=1),
        frame(14),
        frame(20_014),
        frame(0),
        frame(501, unit=1),
    ):
        receiver.receive(data)
    counters = receiver.counters
    assert (counters.sequence_gaps, counters.lost_packets, counters.restarts) == (2, 2 + 19_999, 1)


def test_the_longest_packet_passes_and_the_buffer_holds_no_more():
    data = Device(INTERFACE).serial_bytes(example.HEADER, FULL_BEAMS)
    receiver = SerialReceiver(INTERFACE)
    (message,) = receiver.receive(data)
    assert len(message.beams) == 64
    highest = 0
    for _ in range(1000):
        receiver.receive(b"\x55" * 100)
        highest = max(highest, receiver.buffered_bytes)
    assert 1000 < highest <= cobs.stuffed_length(INTERFACE.maximum_packet_bytes)
    assert shots(receiver.receive(b"\0" + frame(3))) == [3]


ANY_FRAME = st.binary(max_size=400).map(lambda data: cobs.encode(data) + b"\0")
SEALED = st.builds(sealed, st.integers(0x29F, 0x2B0), st.integers(0, 2**14 - 1), st.binary(max_size=400))
HEADED = st.builds(
    lambda head, version, count, blocks: (
        head + bytes((version,)) + head[:2] + bytes((count,)) + bytes(4) + blocks
    ),
    st.binary(min_size=14, max_size=14),
    st.integers(0, 2),
    st.integers(0, 3),
    st.integers(0, 3).flatmap(lambda n: st.binary(min_size=28 * n, max_size=28 * n)),
)
HEADED_SEALED = HEADED.map(lambda body: sealed(0x2A0, 0, body))


@settings(max_examples=300)
@given(
    st.lists(
        st.binary(max_size=200) | ANY_FRAME | (SEALED | HEADED_SEALED).map(lambda p: cobs.encode(p) + b"\0")
    )
)
def test_nothing_that_arrives_raises(portions):
    receiver = SerialReceiver(INTERFACE)
    delivered = sum(len(receiver.receive(portion)) for portion in portions)
    counters = receiver.counters
    bad = counters.bad_stuffing + counters.bad_length + counters.bad_crc + counters.foreign
    assert counters.messages == delivered
    assert counters.frames == delivered + bad
    assert receiver.buffered_bytes <= cobs.stuffed_length(INTERFACE.maximum_packet_bytes)


def test_a_packet_without_beams_is_refused():
    body = INTERFACE.packet.header.pack(example.HEADER, {"interface_version": 3, "beam_count": 1})
    empty = sealed(0x2A0, 0, body[:17] + bytes(1) + body[18:])
    receiver = SerialReceiver(INTERFACE)
    assert receiver.receive(cobs.encode(empty) + cobs.DELIMITER) == []
    assert receiver.counters.bad_length == 1


def test_a_sender_refuses_what_cannot_be_sent():
    with pytest.raises(EncodeError, match="unit 16"):
        packet.encode(INTERFACE, 16, example.HEADER, example.BEAMS)
    with pytest.raises(EncodeError, match="65 beams"):
        packet.encode(INTERFACE, 0, example.HEADER, [*FULL_BEAMS, example.BEAMS[0]])
    with pytest.raises(EncodeError, match="0 beams"):
        packet.encode(INTERFACE, 0, example.HEADER, [])
    with pytest.raises(EncodeError, match="shot"):
        packet.encode(INTERFACE, 0, {**example.HEADER, "shot": None}, example.BEAMS)
