"""First difference of two packets, by the names of the interface's fields."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from lidar_emu.runtime.port.packets import OutgoingPacket
from lidar_emu.transports.frames import unpack_frames
from lidar_protocol import CanReceiver, Interface, Message, SerialReceiver


class PacketDifference(NamedTuple):
    """A value that differs between the recorded and the recomputed packet."""

    shot: int
    beam: int | None
    """None: a field of the whole packet."""
    field: str
    recorded: Any
    recomputed: Any


def first_difference(
    recorded: OutgoingPacket, recomputed: OutgoingPacket, interface: Interface, can: bool
) -> PacketDifference:
    """First field in which two packets of a shot differ, or the first byte if they cannot be decoded.

    Args:
        recorded: packet of the recording.
        recomputed: packet computed again; differs from `recorded`.
        interface: interface definition of both.
        can: whether the payloads are CAN frame records.
    """
    shot = recorded.shot
    if recorded.due_ns != recomputed.due_ns:
        return PacketDifference(shot, None, "due_ns", recorded.due_ns, recomputed.due_ns)
    if not (recorded.payload and recomputed.payload):
        return PacketDifference(shot, None, "bytes", len(recorded.payload), len(recomputed.payload))
    pair = (_decoded(packet.payload, interface, can) for packet in (recorded, recomputed))
    was, now = pair
    if was is not None and now is not None:
        for beam, name, left, right in _fields(was, now):
            if left != right:
                return PacketDifference(shot, beam, name, left, right)
    place = next(
        (k for k, (a, b) in enumerate(zip(recorded.payload, recomputed.payload, strict=False)) if a != b),
        min(len(recorded.payload), len(recomputed.payload)),
    )
    ends = (packet.payload[place : place + 1].hex() or None for packet in (recorded, recomputed))
    return PacketDifference(shot, None, f"byte {place}", *ends)


def _decoded(payload: bytes, interface: Interface, can: bool) -> Message | None:
    if can:
        receiver = CanReceiver(interface)
        received = [m for f in unpack_frames(payload) for m in receiver.receive(f.can_id, f.data, f.is_fd)]
    else:
        received = list(SerialReceiver(interface).receive(payload))
    messages = [message for message in received if isinstance(message, Message)]
    return messages[0] if len(messages) == 1 else None


def _fields(was: Message, now: Message) -> Iterator[tuple[int | None, str, Any, Any]]:
    yield None, "sequence", was.sequence, now.sequence
    yield None, "beams", len(was.beams), len(now.beams)
    for name, value in was.header.items():
        yield None, name, value, now.header.get(name)
    for beam, (left, right) in enumerate(zip(was.beams, now.beams, strict=True)):
        for name, value in left.items():
            yield beam, name, value, right.get(name)
