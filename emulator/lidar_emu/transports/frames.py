"""CAN frames, and the frames of a shot as one byte string.

A record is: identifier u32, flags u8 (1 FD, 2 bit rate switch, 4 extended identifier), length u8, data;
little-endian. A packet for a CAN port is a concatenation of records, so that rings and pipes carry bytes
on every kind of link.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import NamedTuple

_RECORD = struct.Struct("<IBB")
_FD, _BITRATE_SWITCH, _EXTENDED = 1, 2, 4


class Frame(NamedTuple):
    """One data frame."""

    can_id: int
    data: bytes
    is_fd: bool = False
    bitrate_switch: bool = False
    is_extended: bool = False


def pack_frames(frames: Iterable[Frame]) -> bytes:
    """The frames as records, in order."""
    parts: list[bytes] = []
    for frame in frames:
        flags = frame.is_fd * _FD | frame.bitrate_switch * _BITRATE_SWITCH | frame.is_extended * _EXTENDED
        parts += (_RECORD.pack(frame.can_id, flags, len(frame.data)), frame.data)
    return b"".join(parts)


def unpack_frames(payload: bytes) -> list[Frame]:
    """The frames of `pack_frames`.

    Raises:
        ValueError: the payload ends inside a record.
    """
    frames = []
    start = 0
    while start < len(payload):
        if start + _RECORD.size > len(payload):
            raise ValueError("frame records end inside a header")
        can_id, flags, length = _RECORD.unpack_from(payload, start)
        start += _RECORD.size
        data = payload[start : start + length]
        if len(data) != length:
            raise ValueError("frame records end inside a frame's data")
        is_fd, bitrate_switch, is_extended = (bool(flags & bit) for bit in (_FD, _BITRATE_SWITCH, _EXTENDED))
        frames.append(Frame(can_id, data, is_fd, bitrate_switch, is_extended))
        start += length
    return frames
