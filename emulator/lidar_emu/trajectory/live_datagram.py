"""Datagrams of a simulator's truth and of the reply in lockstep: bytes in, values out.

The layout is documented, with a client to copy, in docs/live-truth.md. All numbers are little-endian and lie on
multiples of their size, so that a packed C structure is the datagram.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from enum import IntEnum
from typing import NamedTuple

VERSION = 1
_TRUTH_MAGIC, _ANSWER_MAGIC = b"LETR", b"LEAN"
_HEAD = struct.Struct("<4sHHI4xq")
_TRUTH = struct.Struct("<4sHHI4xq3d3d3d4d3d")
_ANSWER = struct.Struct("<4sHBBIIq")
_PACKET = struct.Struct("<IIqB7x")
_ACCELERATION_KNOWN, _LAST = 1, 2
_LONGEST_ANSWER_BYTES = 60_000

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

TRUTH_BYTES = _TRUTH.size


class Verdict(IntEnum):
    """Verdict on a truth; its value is the status of the reply."""

    ACCEPTED = 0
    MALFORMED = 1
    """Not a truth of this version."""
    NOT_FINITE = 2
    """NaN or infinity where a number belongs."""
    BAD_ATTITUDE = 3
    """The quaternion is not a unit quaternion to a thousandth."""
    DUPLICATE = 4
    """Same instant as the newest truth."""
    OUT_OF_ORDER = 5
    """Older than the newest truth."""
    IMPLAUSIBLE_TIME = 6
    """Further ahead than truth may be, or more than 10 s old; in lockstep more than 10 s after the newest truth. For
    the first truth, before scenario time 0 or beyond the longest run."""


class Truth(NamedTuple):
    """Motion of the vehicle's reference point at an instant. Site frame east, north, up; body x forward, z down."""

    sequence: int
    time_ns: int
    """Scenario time."""
    position_site_m: Vector
    velocity_site_mps: Vector
    acceleration_site_mps2: Vector | None
    """None where the simulator does not know it."""
    site_from_body: Quaternion
    """Unit quaternion, scalar first."""
    body_rate_radps: Vector
    """Angular rate of the body against the site, about body x, y and z."""
    last: bool = False
    """The flight ends here."""

    def to_bytes(self) -> bytes:
        """The datagram."""
        acceleration = self.acceleration_site_mps2
        flags = (acceleration is not None) * _ACCELERATION_KNOWN | self.last * _LAST
        return _TRUTH.pack(
            _TRUTH_MAGIC, VERSION, flags, self.sequence, self.time_ns,
            *self.position_site_m, *self.velocity_site_mps, *(acceleration or (0.0, 0.0, 0.0)),
            *self.site_from_body, *self.body_rate_radps,
        )  # fmt: skip

    @classmethod
    def from_bytes(cls, datagram: bytes) -> Truth | None:
        """The inverse of `to_bytes`; None for anything else."""
        if len(datagram) != TRUTH_BYTES:
            return None
        magic, version, flags, sequence, time_ns, *values = _TRUTH.unpack(datagram)
        if magic != _TRUTH_MAGIC or version != VERSION:
            return None
        px, py, pz, vx, vy, vz, ax, ay, az, qw, qx, qy, qz, rx, ry, rz = values
        acceleration = (ax, ay, az) if flags & _ACCELERATION_KNOWN else None
        motion = (px, py, pz), (vx, vy, vz), acceleration, (qw, qx, qy, qz), (rx, ry, rz)
        return cls(sequence, time_ns, *motion, bool(flags & _LAST))


def sequence_of(datagram: bytes) -> int:
    """Sequence number to which the reply to a datagram refers; 0 if the datagram has none."""
    if len(datagram) < _HEAD.size or datagram[:4] != _TRUTH_MAGIC:
        return 0
    return int(_HEAD.unpack_from(datagram)[3])


class AnsweredPacket(NamedTuple):
    """A packet in a reply."""

    shot: int
    due_ns: int
    status: int
    """Delivery status on the link: a `transports.link.DeliveryStatus`."""
    payload: bytes
    """As on the link; on CAN as frame records."""


class Answer(NamedTuple):
    """A datagram of the reply to a truth, in lockstep."""

    verdict: Verdict
    more: int
    """Number of datagrams of the same reply that follow; 255 means 255 or more."""
    sequence: int
    time_ns: int
    """Time of the truth: all packets due up to then have been sent."""
    packets: tuple[AnsweredPacket, ...]

    def to_bytes(self) -> bytes:
        """The datagram."""
        head = _ANSWER.pack(
            _ANSWER_MAGIC, VERSION, self.verdict, self.more, self.sequence, len(self.packets), self.time_ns
        )
        return head + b"".join(
            _PACKET.pack(len(p.payload), p.shot & 0xFFFFFFFF, p.due_ns, p.status) + p.payload
            for p in self.packets
        )

    @classmethod
    def from_bytes(cls, datagram: bytes) -> Answer:
        """The inverse of `to_bytes`.

        Raises:
            ValueError: the datagram is not a reply of this version.
        """
        try:
            magic, version, verdict, more, sequence, count, time_ns = _ANSWER.unpack_from(datagram)
            packets, start = [], _ANSWER.size
            for _ in range(count):
                length, shot, due_ns, status = _PACKET.unpack_from(datagram, start)
                start += _PACKET.size + length
                packets.append(AnsweredPacket(shot, due_ns, status, datagram[start - length : start]))
        except struct.error as error:
            raise ValueError(f"not an answer: {error}") from None
        if (magic, version, start) != (_ANSWER_MAGIC, VERSION, len(datagram)):
            raise ValueError("not an answer of this version")
        return cls(Verdict(verdict), more, sequence, time_ns, tuple(packets))


def answers(verdict: Verdict, sequence: int, time_ns: int, packets: Iterable[AnsweredPacket]) -> list[Answer]:
    """Build a reply, divided into datagrams of a size that UDP carries."""
    parts: list[list[AnsweredPacket]] = [[]]
    left_bytes = _LONGEST_ANSWER_BYTES
    for packet in packets:
        size = _PACKET.size + len(packet.payload)
        if size > left_bytes and parts[-1]:
            parts.append([])
            left_bytes = _LONGEST_ANSWER_BYTES
        parts[-1].append(packet)
        left_bytes -= size
    last = len(parts) - 1
    return [
        Answer(verdict, min(last - k, 255), sequence, time_ns, tuple(part)) for k, part in enumerate(parts)
    ]
