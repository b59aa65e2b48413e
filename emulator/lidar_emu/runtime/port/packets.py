"""Packets between the model process and the port process: their records, and when each is sent."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import TYPE_CHECKING, NamedTuple, Self

from lidar_emu.transports.frames import Frame, pack_frames
from lidar_emu.transports.link import DeliveryStatus as DeliveryStatus

if TYPE_CHECKING:
    from lidar_emu.wire import Packet

CHANGED, WAKE_UP = b"\0", b"\1"
"""Bytes in the doorbell pipe of the port process: something has changed; a packet that is due follows at once."""

_PACKET_HEAD = struct.Struct("<qqI")
PACKET_HEAD_BYTES = _PACKET_HEAD.size
_REPORT = struct.Struct("<qqqBq")


class OutgoingPacket(NamedTuple):
    """A finished packet, from the model process to the port process."""

    shot: int
    due_ns: int
    """Due time, from the start of the run."""
    payload: bytes
    """Framed bytes on a byte link, frame records (`pack_frames`) on CAN."""
    generation: int = 0
    """How often computed shots had been superseded when this packet was made."""

    def to_bytes(self) -> bytes:
        """The packet as a ring entry."""
        return _PACKET_HEAD.pack(self.shot, self.due_ns, self.generation) + self.payload

    @classmethod
    def from_bytes(cls, entry: bytes) -> Self:
        """The inverse of `to_bytes`."""
        shot, due_ns, generation = _PACKET_HEAD.unpack_from(entry)
        return cls(shot, due_ns, entry[_PACKET_HEAD.size :], generation)


@dataclass(frozen=True)
class DeliveryReport:
    """The delivery status of a packet, from the port process to the model process."""

    shot: int
    due_ns: int
    """Due time, from the start of the run."""
    sent_ns: int
    """When the link had taken the packet, from the start of the run; -1 if it did not. With status SUPERSEDED: the
    number of packets."""
    status: DeliveryStatus
    woke_ns: int = -1
    """When the port process woke up for the packet, from the start of the run; -1 if that was before the start."""

    SIZE_BYTES = _REPORT.size

    @property
    def packets(self) -> int:
        """Number of packets that this report covers."""
        return self.sent_ns if self.status is DeliveryStatus.SUPERSEDED else 1

    def to_bytes(self) -> bytes:
        """The report as a ring entry."""
        return _REPORT.pack(self.shot, self.due_ns, self.sent_ns, self.status, self.woke_ns)

    @classmethod
    def from_bytes(cls, entry: bytes) -> Self:
        """The inverse of `to_bytes`."""
        shot, due_ns, sent_ns, status, woke_ns = _REPORT.unpack(entry)
        return cls(shot, due_ns, sent_ns, DeliveryStatus(status), woke_ns)


class ReceivedBytes(NamedTuple):
    """Bytes that arrived on the port. Instants are of the monotonic clock."""

    at_ns: int
    data: bytes
    """On CAN, frame records."""
    pulse_ns: int | None
    """When the last synchronisation pulse came before these bytes; None: there was none, or the port has no pulse
    line."""


def payload_of(packet: Packet) -> bytes:
    """A packet as the port process takes it: bytes, or frame records on CAN."""
    if isinstance(packet, bytes):
        return packet
    return pack_frames([Frame(f.can_id, f.data, f.is_fd, f.bitrate_switch) for f in packet])


class Pace(StrEnum):
    """What sets the pace of a run."""

    WALL = "wall"
    """The wall clock: a packet goes out when it is due, or not at all."""
    MAX = "max"
    """The link: packets go out as fast as it takes them; nothing is late.

    The sender waits for a full line and for the first reader of a pty, but not forever: after 5 s in which the line
    has taken nothing there is a link event, and after 30 s without progress packets are dropped, as line full or as
    no reader, until there is progress again. Once a pty has had a reader, the sender no longer waits for one."""
    LOCKSTEP = "lockstep"
    """Live truth: a packet goes out, as with `MAX`, once truth beyond its shot has arrived."""


class WhenLate(StrEnum):
    """What happens when a packet is late."""

    SKIP = "skip"
    """It is skipped, and the next one goes out when it is due."""
    ABORT = "abort"
    """The run ends: nothing more is sent."""


class Action(Enum):
    """What to do with the next packet."""

    WAIT = "wait"
    SEND = "send"
    SKIP = "skip"


@dataclass(frozen=True)
class Pacing:
    """Decides when packets are sent.

    After a stall, overdue packets are skipped: an instrument would not send them in a burst either.
    """

    pace: Pace
    late_after_ns: int
    """A packet is late, and skipped, if its transmission could not begin within this time after it was due."""
    when_late: WhenLate = WhenLate.SKIP
    poll_ns: int = 0
    """How long a packet that is due waits for a poll, unless the next one is due before; 0: it is sent unasked."""

    def action(self, now_ns: int, due_ns: int) -> Action:
        """What to do at `now_ns` with a packet due at `due_ns`, both from the start of the run."""
        if self.pace is not Pace.WALL:
            return Action.SEND
        if now_ns < due_ns:
            return Action.WAIT
        return Action.SKIP if now_ns > due_ns + self.late_after_ns else Action.SEND
