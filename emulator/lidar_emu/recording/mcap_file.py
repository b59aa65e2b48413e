"""Records of an MCAP file in order, up to its end or to the point of truncation."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.records import Channel, Footer, Message, Metadata
from mcap.stream_reader import StreamReader

from lidar_emu.errors import Finding, InputError, reason_of

MAGIC = b"\x89MCAP0\r\n"
"""First bytes of an MCAP file."""
_LONGEST_RECORD = 1 << 28
ALLOWED = "allowed: a recording made by lidar-emu run --record"


def first_bytes(path: Path, allowed: str) -> bytes:
    """First bytes of a file, as many as identify MCAP; fewer of a shorter file.

    Args:
        path: file to read.
        allowed: what is allowed, for the error message.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            return file.read(len(MAGIC))
    except (OSError, ValueError) as error:
        raise InputError(str(path), None, Finding(reason_of(error)), allowed) from None


class McapFile:
    """An MCAP file that can be iterated repeatedly.

    Args:
        path: file to read.

    Raises:
        InputError: the file cannot be read, or is not MCAP.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.is_whole = False
        """Whether the file ends with its footer; known once `metadata` or `messages` have been exhausted."""
        begins = first_bytes(path, ALLOWED)
        if begins != MAGIC:
            raise InputError(str(path), None, Finding("empty" if not begins else "not MCAP"), ALLOWED)

    def metadata(self, name: str) -> dict[str, str] | None:
        """First metadata record of a name; None if there is none."""
        for record in self._records():
            if isinstance(record, Metadata) and record.name == name:
                return dict(record.metadata)
        return None

    def messages(self, *topics: str) -> Iterator[tuple[str, int, bytes]]:
        """Topic, log time and data of the messages of these topics, in the order of the file."""
        selected: dict[int, str] = {}
        for record in self._records():
            if isinstance(record, Channel) and record.topic in topics:
                selected[record.id] = record.topic
            elif isinstance(record, Message) and record.channel_id in selected:
                yield selected[record.channel_id], record.log_time, record.data

    def _records(self) -> Iterator[Any]:
        self.is_whole = False
        with self._path.open("rb") as file:
            reader = StreamReader(file, record_size_limit=_LONGEST_RECORD)
            try:
                for record in reader.records:
                    self.is_whole = isinstance(record, Footer)
                    yield record
            # A truncated or damaged record: the library raises these exceptions for bytes that it cannot parse.
            except (McapError, struct.error, ValueError, EOFError, KeyError, IndexError):
                return
