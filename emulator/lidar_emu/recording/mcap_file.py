"""Records of an MCAP file in their order, up to its end or to where it was cut."""

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
"""How the file begins."""
_LONGEST_RECORD = 1 << 28
ALLOWED = "allowed: a recording made by lidar-emu run --record"


def first_bytes(path: Path, allowed: str) -> bytes:
    """As many as tell an MCAP file from others; fewer of a shorter file.

    Raises:
        InputError: it cannot be read; tells what is allowed.
    """
    try:
        with path.open("rb") as file:
            return file.read(len(MAGIC))
    except (OSError, ValueError) as error:
        raise InputError(str(path), None, Finding(reason_of(error)), allowed) from None


class McapFile:
    """A file that can be gone through again and again.

    Args:
        path: of the file.

    Raises:
        InputError: it cannot be read, or does not begin as MCAP does.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.is_whole = False
        """Whether the end was reached, and it was the end that the writer made; known after `metadata` or `messages`
        have been gone through."""
        begins = first_bytes(path, ALLOWED)
        if begins != MAGIC:
            raise InputError(str(path), None, Finding("empty" if not begins else "no MCAP"), ALLOWED)

    def metadata(self, name: str) -> dict[str, str] | None:
        """The first metadata of that name; None: there is none."""
        for record in self._records():
            if isinstance(record, Metadata) and record.name == name:
                return dict(record.metadata)
        return None

    def messages(self, *topics: str) -> Iterator[tuple[str, int, bytes]]:
        """Topic, log time and data of the messages under these topics, in the order of the file."""
        wanted: dict[int, str] = {}
        for record in self._records():
            if isinstance(record, Channel) and record.topic in topics:
                wanted[record.id] = record.topic
            elif isinstance(record, Message) and record.channel_id in wanted:
                yield wanted[record.channel_id], record.log_time, record.data

    def _records(self) -> Iterator[Any]:
        self.is_whole = False
        with self._path.open("rb") as file:
            reader = StreamReader(file, record_size_limit=_LONGEST_RECORD)
            try:
                for record in reader.records:
                    self.is_whole = isinstance(record, Footer)
                    yield record
            # A record that was cut short, or is none: what a library raises over bytes that it does not understand.
            except (McapError, struct.error, ValueError, EOFError, KeyError, IndexError):
                return
