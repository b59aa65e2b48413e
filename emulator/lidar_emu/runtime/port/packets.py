"""What passes between the model's process and the port's: packets one way, reports the other."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Self

from lidar_emu.transports.frames import Frame, pack_frames, unpack_frames
from lidar_emu.transports.link import DeliveryStatus

__all__ = ["ALERT", "NEWS", "DeliveryStatus", "Frame", "Outgoing", "Report", "pack_frames", "unpack_frames"]

NEWS, ALERT = b"\0", b"\1"
"""What the doorbell of the port's process says: something has changed; a packet that is due will follow at once."""

_PACKET_HEAD = struct.Struct("<qqI")
_REPORT = struct.Struct("<qqqBq")


@dataclass(frozen=True)
class Outgoing:
    """A finished packet."""

    shot: int
    due_ns: int
    """From the start of the run."""
    payload: bytes
    """Framed bytes on a byte link, frame records (`pack_frames`) on CAN."""
    generation: int = 0
    """How many commands had changed shots that were computed already."""

    HEAD_BYTES = _PACKET_HEAD.size

    def to_bytes(self) -> bytes:
        """As a ring entry."""
        return _PACKET_HEAD.pack(self.shot, self.due_ns, self.generation) + self.payload

    @classmethod
    def from_bytes(cls, entry: bytes) -> Self:
        """The inverse of `to_bytes`."""
        shot, due_ns, generation = _PACKET_HEAD.unpack_from(entry)
        return cls(shot, due_ns, entry[_PACKET_HEAD.size :], generation)


@dataclass(frozen=True)
class Report:
    """What became of a packet."""

    shot: int
    due_ns: int
    """From the start of the run."""
    sent_ns: int
    """When the link had taken it, from the start of the run; -1 if it did not. Of superseded packets: their number."""
    status: DeliveryStatus
    woke_ns: int = -1
    """When the port's process had woken up for it, from the start of the run; -1 if that was before the start."""

    SIZE_BYTES = _REPORT.size

    @property
    def packets(self) -> int:
        """Of how many packets this tells."""
        return self.sent_ns if self.status is DeliveryStatus.SUPERSEDED else 1

    def to_bytes(self) -> bytes:
        """As a ring entry."""
        return _REPORT.pack(self.shot, self.due_ns, self.sent_ns, self.status, self.woke_ns)

    @classmethod
    def from_bytes(cls, entry: bytes) -> Self:
        """The inverse of `to_bytes`."""
        shot, due_ns, sent_ns, status, woke_ns = _REPORT.unpack(entry)
        return cls(shot, due_ns, sent_ns, DeliveryStatus(status), woke_ns)
