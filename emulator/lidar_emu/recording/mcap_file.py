"""Messages of an MCAP file in order, past what is damaged in it, up to its end or to the point of truncation.

A record states its length, so that one whose length is damaged hides where the next one starts. Reading resumes where
three records follow one another again.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Metadata
from mcap.stream_reader import breakup_chunk

from lidar_emu.errors import Finding, InputError, reason_of
from lidar_emu.files import check_file

MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of an MCAP file."""
NOT_A_RECORDING = "must be a recording made by lidar-emu run --record"

_LONGEST_RECORD = 1 << 28
_BUFFER_BYTES = 1 << 20
_HEADER = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_FOOTER = _HEADER.pack(Opcode.FOOTER, 20)
_CHAIN = 3
"""Records in a row by which a place counts as the start of one."""
# Opcode, and a length below 2^32.
_RECORD_START = re.compile(rb"[\x01-\x0f](?=.{4}\0{4})", re.DOTALL)
_PARSED: dict[int, Any] = {Opcode.CHANNEL: Channel, Opcode.METADATA: Metadata, Opcode.CHUNK: Chunk}
_UNREADABLE = (McapError, struct.error, ValueError, EOFError, LookupError, OverflowError, RuntimeError)
"""Exceptions of the library, and of its decompressors, for bytes that are no record."""


def first_bytes(path: Path, remedy: str) -> bytes:
    """First bytes of a file, as many as identify MCAP; fewer of a shorter file.

    Args:
        path: file to read.
        remedy: what the error message asks for.

    Raises:
        InputError: the file cannot be read.
    """
    check_file(path, remedy)
    try:
        with path.open("rb") as file:
            return file.read(len(MAGIC))
    except (OSError, ValueError) as error:
        raise InputError(str(path), None, Finding(reason_of(error)), remedy) from None


@dataclass
class Damage:
    """What could not be read, as far as the file has been read."""

    skipped: dict[int, int] = field(default_factory=dict)
    """Number of skipped bytes by their position in the file."""
    unreadable: dict[str, set[int]] = field(default_factory=dict)
    """Positions of messages that are whole as records, but hold nothing readable, by topic."""

    def __bool__(self) -> bool:
        return bool(self.skipped or self.unreadable)

    def __str__(self) -> str:
        texts = []
        if self.skipped:
            texts.append(f"{sum(self.skipped.values())} bytes at {len(self.skipped)} places skipped")
        if self.unreadable:
            topics = ", ".join(f"{topic} {len(places)}" for topic, places in sorted(self.unreadable.items()))
            texts.append(f"messages that cannot be read: {topics}")
        return "; ".join(texts)

    def to_json(self) -> dict[str, Any]:
        """The counts."""
        unreadable = {topic: len(places) for topic, places in sorted(self.unreadable.items())}
        return {
            "places": len(self.skipped),
            "skipped_bytes": sum(self.skipped.values()),
            "unreadable": unreadable,
        }

    def add_message(self, message: RecordedMessage) -> None:
        """Count a message whose contents cannot be read."""
        self.unreadable.setdefault(message.topic, set()).add(message.position)


class RecordedMessage(NamedTuple):
    """A message, and where its record starts."""

    topic: str
    log_time_ns: int
    sequence: int
    data: bytes
    position: int


@dataclass
class ReadPosition:
    """How far a file has been read that is still being written."""

    offset: int = len(MAGIC)
    """Position of the first record that has not been read."""
    topics: dict[int, str] = field(default_factory=dict)
    """Topics by the number of their channel, as far as they have been read."""


class _Record(NamedTuple):
    position: int
    opcode: int
    content: bytes


class _Snapshot:
    """A file as long as it was when it was opened: what is written meanwhile belongs to the next pass."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.size = file.seek(0, 2)

    def read_at(self, position: int, length: int) -> bytes:
        """Read up to `length` bytes."""
        self._file.seek(position)
        return self._file.read(max(0, min(length, self.size - position)))


class McapFile:
    """An MCAP file that can be iterated repeatedly.

    Args:
        path: file to read.

    Raises:
        InputError: the file cannot be read, or is not MCAP.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.damage = Damage()
        begins = first_bytes(path, NOT_A_RECORDING)
        if begins != MAGIC:
            raise InputError(str(path), None, Finding("empty" if not begins else "not MCAP"), NOT_A_RECORDING)

    @property
    def is_whole(self) -> bool:
        """Whether the file ends with its footer."""
        ending = len(_FOOTER) + 20 + len(MAGIC)
        with self._path.open("rb") as file:
            if file.seek(0, 2) < ending:
                return False
            file.seek(-ending, 2)
            end = file.read()
        return end.startswith(_FOOTER) and end.endswith(MAGIC)

    def metadata(self, name: str) -> dict[str, str] | None:
        """First metadata record of a name; None if there is none."""
        for record in self._records(ReadPosition()):
            if record.opcode == Opcode.METADATA:
                parsed = self._parsed(record)
                if parsed is not None and parsed.name == name:
                    return dict(parsed.metadata)
        return None

    def messages(self, *topics: str, since: ReadPosition | None = None) -> Iterator[RecordedMessage]:
        """Messages of these topics, in the order of the file.

        Args:
            topics: the topics.
            since: where to begin; moved to the end of what was read. None: at the start of the file.
        """
        since = since or ReadPosition()
        known = since.topics
        for record in self._records(since):
            match record.opcode:
                case Opcode.MESSAGE:
                    channel, sequence, log_time_ns, _ = _MESSAGE.unpack_from(record.content)
                    if (topic := self._topic(known, channel, record)) in topics:
                        data = record.content[_MESSAGE.size :]
                        yield RecordedMessage(topic, log_time_ns, sequence, data, record.position)
                case Opcode.CHANNEL:
                    if (parsed := self._parsed(record)) is not None:
                        known[parsed.id] = parsed.topic
                case Opcode.CHUNK:
                    yield from self._in_chunk(record, known, topics)

    def _in_chunk(
        self, record: _Record, known: dict[int, str], topics: tuple[str, ...]
    ) -> Iterator[RecordedMessage]:
        """Messages of a chunk, which other programs write; a chunk with a wrong checksum is skipped."""
        for each in self._parsed(record) or ():
            if isinstance(each, Channel):
                known[each.id] = each.topic
            elif isinstance(each, Message):
                topic = self._topic(known, each.channel_id, record)
                if topic in topics:
                    yield RecordedMessage(topic, each.log_time, each.sequence, each.data, record.position)

    def _topic(self, known: dict[int, str], channel: int, record: _Record) -> str:
        topic = known.get(channel, "")
        if not topic:
            self.damage.unreadable.setdefault("of an unknown topic", set()).add(record.position)
        return topic

    def _parsed(self, record: _Record) -> Any:
        """A channel, metadata, or the records of a chunk; None if it cannot be parsed, which is counted."""
        try:
            parsed = _PARSED[Opcode(record.opcode)].read(ReadDataStream(BytesIO(record.content)))
            return breakup_chunk(parsed, validate_crc=True) if isinstance(parsed, Chunk) else parsed
        except _UNREADABLE:
            self.damage.skipped[record.position] = _HEADER.size + len(record.content)
            return None

    def _records(self, since: ReadPosition) -> Iterator[_Record]:
        with self._path.open("rb", buffering=_BUFFER_BYTES) as opened:
            file, is_end = _Snapshot(opened), False
            while not is_end:
                begin = since.offset
                since.offset = yield from _whole_records(file.read_at(begin, _BUFFER_BYTES), begin)
                if since.offset == begin:
                    is_end = yield from self._record_at(file, since)

    def _record_at(self, file: _Snapshot, since: ReadPosition) -> Generator[_Record, None, bool]:
        """Read a record that is long, damaged, cut off, or followed by such; whether it is the last one."""
        position = since.offset
        opcode, length = _header(file, position) or (0, -1)
        content = file.read_at(position + _HEADER.size, length)
        is_whole = len(content) == length
        if opcode == Opcode.FOOTER and is_whole:
            return True
        end = position + _HEADER.size + length
        if is_whole and _header(file, end) is not None:
            since.offset = end
            yield _Record(position, opcode, content)
            return False
        # This record, or the next one, is damaged or cut off.
        resumed = _next_record(file, position + 1)
        if is_whole and (resumed is None or resumed >= end):
            since.offset = end
            yield _Record(position, opcode, content)
        if resumed is None:
            return True
        if resumed > since.offset:
            self.damage.skipped[since.offset] = resumed - since.offset
        since.offset = resumed
        return False


def _whole_records(data: bytes, position: int) -> Generator[_Record, None, int]:
    """Yield records at the start of bytes from this position of a file, as far as each is whole and the next one's
    header follows; return the position of the end of the last one."""
    at, last = 0, len(data) - _HEADER.size
    header = _HEADER.unpack_from(data) if last >= 0 else (0, 0)
    while _is_header(*header):
        opcode, length = header
        begin = at + _HEADER.size
        end = begin + length
        if end > last or opcode == Opcode.FOOTER:
            break
        header = _HEADER.unpack_from(data, end)
        if not _is_header(*header):
            break
        yield _Record(position + at, opcode, data[begin:end])
        at = end
    return position + at


def _is_header(opcode: int, length: int) -> bool:
    shortest = _MESSAGE.size if opcode == Opcode.MESSAGE else 0
    return 1 <= opcode <= 15 and shortest <= length <= _LONGEST_RECORD


def _header(file: _Snapshot, position: int) -> tuple[int, int] | None:
    """Opcode and length of the record at a position; None if there can be no record."""
    data = file.read_at(position, _HEADER.size)
    if len(data) < _HEADER.size:
        return None
    opcode, length = _HEADER.unpack(data)
    return (opcode, length) if _is_header(opcode, length) else None


def _next_record(file: _Snapshot, position: int) -> int | None:
    while True:
        window = file.read_at(position, _BUFFER_BYTES)
        for found in _RECORD_START.finditer(window):
            if _starts_a_chain(file, position + found.start()):
                return position + found.start()
        if len(window) < _BUFFER_BYTES:
            return None
        position += len(window) - _HEADER.size + 1


def _starts_a_chain(file: _Snapshot, position: int) -> bool:
    """Whether records follow one another from here on, up to the end of the file if that is near."""
    for _ in range(_CHAIN):
        header = _header(file, position)
        if header is None or position + _HEADER.size + header[1] > file.size:
            return False
        position += _HEADER.size + header[1]
        if header[0] == Opcode.FOOTER or position == file.size:
            return True
    return True
