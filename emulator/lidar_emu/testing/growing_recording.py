"""A recording that is still being written: its shots so far.

Source: the MCAP specification, https://mcap.dev/spec, sections on Channel and Message; recordings have no chunks.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_MAGIC_BYTES = 8
_HEAD = struct.Struct("<BQ")
_CHANNEL, _MESSAGE = 4, 5
_CHANNEL_HEAD = struct.Struct("<HHI")
_MESSAGE_HEAD = struct.Struct("<HIQQ")


@dataclass(frozen=True)
class Shot:
    """A shot of an emulated lidar whose delivery status is known."""

    number: int
    """Number of the shot, from 0."""
    status: str
    """Delivery status: `sent`, `late`, `dropped_full`, `dropped_nobody`, `dropped_broken`, `suppressed` or `held`."""
    packet: bytes
    """Bytes as on the link, on CAN frame records; empty if the device sent none."""
    truth: dict[str, Any]
    """Ground truth: the fields of `/truth` in docs/recordings.md, a list entry per beam, None where there is no
    value."""
    measurement: dict[str, Any]
    """Measurement: the fields of `/measurement`, likewise."""


class GrowingRecording:
    """Reads the shots of a recording as they are written.

    Args:
        path: the recording; it need not exist yet.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._read_bytes = 0
        self._topics: dict[int, str] = {}
        self._packet = b""
        self._delivered: dict[int, tuple[str, bytes]] = {}
        self._truth: dict[str, Any] = {}

    def new_shots(self) -> list[Shot]:
        """The shots that were written since the last call."""
        shots: list[Shot] = []
        for topic, data in self._new_messages():
            match topic:
                case "/packet":
                    self._packet = data
                case "/delivery":
                    delivery = json.loads(data)
                    self._delivered[delivery["shot"]] = delivery["status"], self._packet
                    self._packet = b""
                case "/truth":
                    self._truth = json.loads(data)
                case "/measurement":
                    number = self._truth["shot"]
                    shots.append(Shot(number, *self._delivered.pop(number), self._truth, json.loads(data)))
        return shots

    def _new_messages(self) -> list[tuple[str, bytes]]:
        """Topic and data of the messages that are complete by now."""
        if not self._path.exists():
            return []
        with self._path.open("rb") as file:
            file.seek(self._read_bytes or _MAGIC_BYTES)
            new = file.read()
        messages: list[tuple[str, bytes]] = []
        at = 0
        while at + _HEAD.size <= len(new):
            kind, length = _HEAD.unpack_from(new, at)
            begins, ends = at + _HEAD.size, at + _HEAD.size + length
            if ends > len(new):
                break
            at = ends
            if kind == _CHANNEL:
                number, _, topic_bytes = _CHANNEL_HEAD.unpack_from(new, begins)
                topic_begins = begins + _CHANNEL_HEAD.size
                self._topics[number] = new[topic_begins : topic_begins + topic_bytes].decode()
            elif kind == _MESSAGE:
                number, *_ = _MESSAGE_HEAD.unpack_from(new, begins)
                messages.append((self._topics[number], new[begins + _MESSAGE_HEAD.size : ends]))
        self._read_bytes = max(self._read_bytes, _MAGIC_BYTES) + at
        return messages
