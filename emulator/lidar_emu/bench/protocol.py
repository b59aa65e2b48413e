"""Cost of packets and frames, compared with a slow exact path: field by field, CRCs bit by bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import partial
from math import floor
from typing import Final, NamedTuple

from lidar_emu.bench.stopwatch import median_times_s
from lidar_icd.example import BEAMS, HEADER
from lidar_protocol import (
    CanFrame,
    CanReceiver,
    CanSet,
    Device,
    Interface,
    Message,
    SerialReceiver,
    default_interface,
)
from lidar_protocol import packet as packets
from lidar_protocol.can_frames import addresses
from lidar_protocol.crc import CRCS, Crc
from lidar_protocol.fields import Counter, Field, Number, Time, Value
from lidar_protocol.layout import Layout

_CALLS: Final = 50
"""In a row, so that reading the clock costs nothing beside them."""

_TICKS_PER_S, _NS_PER_S = 1 << 24, 10**9
_SETS: Final[tuple[CanSet, ...]] = ("core", "full", "fd")
_SHOT: Final = (BEAMS[0],) * 4
_OWN: Final[Mapping[str, Value]] = {
    "interface_version": 2,
    "beam_count": len(_SHOT),
    "shot_counter": HEADER["shot"],
}


class Job(NamedTuple):
    """A task with a fast and an exact implementation."""

    name: str
    fast: Callable[[], object]
    exact: Callable[[], object]


class Cost(NamedTuple):
    """Times of a job."""

    name: str
    time_s: float
    exact_s: float
    """Time of the slow exact path."""


def measure_protocol(rounds: int) -> list[Cost]:
    """Median times of all jobs."""
    jobs = protocol_jobs()
    calls = [call for job in jobs for call in (partial(_often, job.fast), job.exact)]
    times_s = median_times_s(calls, rounds)
    fast_s, exact_s = times_s[::2], times_s[1::2]
    return [
        Cost(job.name, fast / _CALLS, exact) for job, fast, exact in zip(jobs, fast_s, exact_s, strict=True)
    ]


def protocol_jobs() -> list[Job]:
    """A shot of four beams as a packet and as the sets on CAN, built and decoded; each CRC over that packet."""
    interface = default_interface()
    packet = packets.encode(interface, 0, HEADER, _SHOT)
    jobs = _as_packet(interface, packet)
    for can_set in _SETS:
        jobs += _on_can(interface, can_set)
    covered = packet[: -interface.link.crc_length]
    return jobs + [_over(covered, crc) for crc in CRCS.values()]


def _often(job: Callable[[], object]) -> None:
    for _ in range(_CALLS):
        job()


def _as_packet(interface: Interface, packet: bytes) -> list[Job]:
    device, receiver, link = Device(interface), SerialReceiver(interface), interface.link
    header, beam = interface.packet.header, interface.packet.beam
    assert beam is not None
    assert link.crc is not None
    frame, crc = link.framing.encode(packet), link.crc

    def build() -> bytes:
        body = packed(header, {**HEADER, **_OWN}) + b"".join(packed(beam, values) for values in _SHOT)
        start = packet[: link.header.length] + body
        return link.framing.encode(start + bitwise(crc, start).to_bytes(2, "big"))

    def decode() -> list[Message]:
        assert bitwise(crc, packet[:-2]) == int.from_bytes(packet[-2:], "big")
        place = link.header.length + header.length
        beams = [unpacked(beam, packet[start:]) for start in range(place, len(packet) - 2, beam.length)]
        count = int.from_bytes(packet[2:4], "big") & 0x3FFF
        return [Message(0, unpacked(header, packet[link.header.length :]), tuple(beams), count)]

    return [
        Job("packet, built", lambda: device.serial_bytes(HEADER, _SHOT), build),
        Job("packet, checked and decoded", lambda: receiver.receive(frame), decode),
    ]


def _on_can(interface: Interface, can_set: CanSet) -> list[Job]:
    device, receiver, places = Device(interface), CanReceiver(interface), addresses(interface)
    frames = device.can_frames(can_set, HEADER, _SHOT)
    own = {**_OWN, "details": can_set == "full"}

    def build() -> list[CanFrame]:
        return [
            frame._replace(
                data=packed(message.layout, {**(_SHOT[slot] if message.each_beam else HEADER), **own})
            )
            for frame in frames
            for _, message, slot in (places[frame.can_id],)
        ]

    def receive() -> object:
        for can_id, data, is_fd, _ in frames:
            messages = receiver.receive(can_id, data, is_fd)
        return messages

    def decode() -> list[Message]:
        header: dict[str, Value] = {}
        beams: list[dict[str, Value]] = [{"fired": True} for _ in _SHOT]
        for frame in frames:
            _, message, slot = places[frame.can_id]
            to = beams[slot] if message.each_beam else header
            to |= unpacked(message.layout, frame.data)
        header.pop("details", None)
        return [Message(0, header, tuple(beams))]

    return [
        Job(f"CAN {can_set}, built", lambda: device.can_frames(can_set, HEADER, _SHOT), build),
        Job(f"CAN {can_set}, decoded", receive, decode),
    ]


def _over(covered: bytes, crc: Crc) -> Job:
    return Job(
        f"{crc.name}, {len(covered)} bytes", partial(crc.function, covered), partial(bitwise, crc, covered)
    )


def packed(layout: Layout, values: Mapping[str, Value]) -> bytes:
    """A big-endian block, field by field."""
    word = 0
    for field, first_bit in layout.placed:
        shift = 8 * layout.length - first_bit - field.codec.bits
        word |= (_raw(field, values[field.name]) & (1 << field.codec.bits) - 1) << shift
    return word.to_bytes(layout.length, "big")


def unpacked(layout: Layout, data: bytes) -> dict[str, Value]:
    """The values of a big-endian block, field by field."""
    word = int.from_bytes(data[: layout.length], "big")
    fields = ((field, 8 * layout.length - bit - field.codec.bits) for field, bit in layout.placed)
    return {
        field.name: _value(field, word >> shift) for field, shift in fields if field.name != "shot_counter"
    }


def _raw(field: Field, value: Value) -> int:
    codec = field.codec
    if isinstance(codec, Number):
        if value is None:
            assert codec.none is not None
            return codec.none
        return floor((Fraction(value) - codec.offset) * Fraction(codec.steps_per_unit) + Fraction(1, 2))
    assert value is not None
    if isinstance(codec, Time):
        return floor(Fraction(int(value) * _TICKS_PER_S, _NS_PER_S) + Fraction(1, 2))
    return int(value)


def _value(field: Field, word: int) -> Value:
    codec = field.codec
    raw = word & (1 << codec.bits) - 1
    if isinstance(codec, Time):
        return floor(Fraction(raw * _NS_PER_S, _TICKS_PER_S) + Fraction(1, 2))
    if isinstance(codec, Counter):
        return raw
    if not isinstance(codec, Number):
        return bool(raw)
    number = raw - (1 << codec.bits) if codec.signed and raw >> codec.bits - 1 else raw
    if not codec.lowest <= number <= codec.highest:
        return None
    return number + codec.offset if codec.whole else float(Fraction(number) / Fraction(codec.steps_per_unit))


def bitwise(crc: Crc, data: Sequence[int]) -> int:
    """A CRC, bit by bit."""
    register, top = crc.start, 1 << crc.bits - 1
    for byte in data:
        for bit in range(8):
            following = byte >> (bit if crc.reflected else 7 - bit) & 1
            is_set = bool(register & top) != bool(following)
            register = (register << 1 & (1 << crc.bits) - 1) ^ (crc.polynomial if is_set else 0)
    turned = int(f"{register:0{crc.bits}b}"[::-1], 2) if crc.reflected else register
    return turned ^ crc.final_xor
