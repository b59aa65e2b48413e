"""Framing of packets in a byte stream, and readers that find the frames."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Generic, Literal, NamedTuple, TypeVar

from lidar_protocol import cobs
from lidar_protocol.errors import DecodeError, Fault

T = TypeVar("T")

Read = Callable[[bytes], T]
"""Decodes a packet; raises DecodeError."""


@dataclass(slots=True)
class LinkCounters:
    """Counters of received traffic on a byte link."""

    frames: int = 0
    """Frames, valid or not; empty ones are not counted. With a sync word, its occurrences."""
    messages: int = 0
    """Frames with a valid packet."""
    bad_stuffing: int = 0
    """Frames with invalid stuffing."""
    bad_length: int = 0
    """Frames that are too long, or whose length is not the stated one."""
    bad_crc: int = 0
    """Packets with a wrong CRC."""
    foreign: int = 0
    """Valid packets of another kind, address or interface version."""
    skipped_bytes: int = 0
    """Bytes that belong to no message, without delimiters."""

    def count(self, fault: Fault) -> None:
        """Count a fault."""
        setattr(self, fault, getattr(self, fault) + 1)


class FrameReader(ABC, Generic[T]):
    """Finds packets in a stream received in portions of any size; raises no exception and buffers a bounded number of
    bytes."""

    def __init__(self, longest: int, read: Read[T], counters: LinkCounters) -> None:
        self._longest, self._read, self._counters = longest, read, counters
        self._buffer = bytearray()

    @property
    def buffered_bytes(self) -> int:
        """Number of bytes that may belong to a frame; at most the longest frame."""
        return len(self._buffer)

    @abstractmethod
    def receive(self, data: bytes) -> list[T]:
        """Decode received bytes; returns the packets that they complete."""


class _Stuffing(NamedTuple):
    delimiter: bytes
    encode: Callable[[bytes], bytes]
    decode: Callable[[bytes], bytes]
    stuffed_length: Callable[[int], int]


# Serial line IP framing (RFC 1055): END closes a frame, and is escaped within it.
_END, _ESCAPE, _ESCAPED_END, _ESCAPED_ESCAPE = b"\xc0", b"\xdb", b"\xdb\xdc", b"\xdb\xdd"


def _slip(data: bytes) -> bytes:
    return data.replace(_ESCAPE, _ESCAPED_ESCAPE).replace(_END, _ESCAPED_END)


def _unslip(stuffed: bytes) -> bytes:
    escapes = stuffed.count(_ESCAPE)
    known = stuffed.count(_ESCAPED_END) + stuffed.count(_ESCAPED_ESCAPE)
    if not stuffed or _END in stuffed or escapes != known:
        expected = "a frame is at least one byte, with escapes of END and ESC alone"
        raise DecodeError(Fault.BAD_STUFFING, expected)
    return stuffed.replace(_ESCAPED_END, _END).replace(_ESCAPED_ESCAPE, _ESCAPE)


_STUFFINGS = {
    "cobs": _Stuffing(cobs.DELIMITER, cobs.encode, cobs.decode, cobs.stuffed_length),
    "slip": _Stuffing(_END, _slip, _unslip, lambda length: 2 * length),
}


@dataclass(frozen=True)
class Stuffed:
    """Frames between delimiters, which stuffing removes from their content.

    The delimiter before a frame ends whatever noise precedes it on the line.
    """

    kind: Literal["cobs", "slip"]
    longest_packet: ClassVar[int | None] = None
    """Length in bytes of the longest packet that the framing can carry; None: there is no limit."""
    covers_head: ClassVar[bool] = False
    """Whether a CRC may cover the bytes before the packet."""

    @property
    def delimiter(self) -> bytes:
        return _STUFFINGS[self.kind].delimiter

    @property
    def decode(self) -> Callable[[bytes], bytes]:
        """Function that decodes a frame without its delimiter; raises DecodeError."""
        return _STUFFINGS[self.kind].decode

    def head(self, packet_length: int) -> bytes:  # noqa: ARG002
        """Bytes before a packet: none."""
        return b""

    def encode(self, packet: bytes) -> bytes:
        """Frame a packet."""
        return self.delimiter + _STUFFINGS[self.kind].encode(packet) + self.delimiter

    def packet_of(self, frame: bytes) -> bytes:
        """The packet in a frame, with or without its delimiters.

        Raises:
            DecodeError: the stuffing is invalid.
        """
        return self.decode(frame.strip(self.delimiter))

    def with_packet(self, frame: bytes, packet: bytes) -> bytes:  # noqa: ARG002
        """A frame with another packet of the same length."""
        return self.encode(packet)

    def longest_frame(self, packet_length: int) -> int:
        """Maximum length in bytes of the frame of a packet of this length, without its delimiter."""
        return _STUFFINGS[self.kind].stuffed_length(packet_length)

    def longest_on_line(self, packet_length: int) -> int:
        """Maximum length in bytes of a frame with all that is sent around it."""
        return self.longest_frame(packet_length) + 2

    def reader(self, longest_packet: int, read: Read[T], counters: LinkCounters) -> FrameReader[T]:
        """Reader of frames."""
        return _DelimiterReader(self, self.longest_frame(longest_packet), read, counters)


@dataclass(frozen=True)
class Synced:
    """Frames that start with a sync word and their length."""

    sync: bytes
    length_bytes: int
    byte_order: Literal["big", "little"]
    counts: Literal["packet", "frame"] = "packet"
    """Bytes that the length counts: those after it, or the whole frame."""
    kind: ClassVar[str] = "sync"
    covers_head: ClassVar[bool] = True

    @property
    def longest_packet(self) -> int:
        """Length in bytes of the longest packet that the length field can state."""
        return (1 << 8 * self.length_bytes) - 1 - self.uncounted

    @property
    def head_length(self) -> int:
        """Length in bytes of sync word and length field."""
        return len(self.sync) + self.length_bytes

    @property
    def uncounted(self) -> int:
        """Difference between the stated length and the length of the packet."""
        return self.head_length if self.counts == "frame" else 0

    def head(self, packet_length: int) -> bytes:
        """Bytes before a packet: sync word and length."""
        return self.sync + (packet_length + self.uncounted).to_bytes(self.length_bytes, self.byte_order)

    def encode(self, packet: bytes) -> bytes:
        """Frame a packet."""
        return self.head(len(packet)) + packet

    def packet_of(self, frame: bytes) -> bytes:
        """The packet in a frame."""
        return frame[self.head_length :]

    def with_packet(self, frame: bytes, packet: bytes) -> bytes:
        """A frame with another packet of the same length; its head stays, even if a fault has cut the frame."""
        return frame[: self.head_length] + packet

    def longest_frame(self, packet_length: int) -> int:
        """Length in bytes of the frame of a packet of this length."""
        return self.head_length + packet_length

    longest_on_line = longest_frame

    def reader(self, longest_packet: int, read: Read[T], counters: LinkCounters) -> FrameReader[T]:
        """Reader of frames."""
        return _SyncReader(self, longest_packet, read, counters)


Framing = Stuffed | Synced


class _DelimiterReader(FrameReader[T]):
    def __init__(self, framing: Stuffed, longest: int, read: Read[T], counters: LinkCounters) -> None:
        super().__init__(longest, read, counters)
        self._delimiter, self._decode = framing.delimiter, framing.decode
        self._too_long = False

    def receive(self, data: bytes) -> list[T]:
        *endings, rest = data.split(self._delimiter)
        found: list[T] = []
        for ending in endings:
            if self._buffer or self._too_long:
                self._append(ending)
                ending = bytes(self._buffer)
                self._buffer.clear()
            self._end_of_frame(ending, found)
            self._too_long = False
        if rest:
            self._append(rest)
        return found

    def _append(self, piece: bytes) -> None:
        if self._too_long or len(self._buffer) + len(piece) > self._longest:
            self._counters.skipped_bytes += len(self._buffer) + len(piece)
            self._buffer.clear()
            self._too_long = True
        else:
            self._buffer += piece

    def _end_of_frame(self, frame: bytes, found: list[T]) -> None:
        if not frame and not self._too_long:
            return
        self._counters.frames += 1
        try:
            if self._too_long or len(frame) > self._longest:
                raise DecodeError(Fault.BAD_LENGTH, "longer than the longest packet")
            found.append(self._read(self._decode(frame)))
        except DecodeError as error:
            self._counters.count(error.fault)
            self._counters.skipped_bytes += len(frame)
        else:
            self._counters.messages += 1


class _SyncReader(FrameReader[T]):
    """Reader of frames with a sync word.

    After an invalid packet it resumes at the sync word's second byte: that sync word may have been a coincidence in the
    data, and the next one may overlap it.
    """

    def __init__(self, framing: Synced, longest: int, read: Read[T], counters: LinkCounters) -> None:
        super().__init__(longest, read, counters)
        self._framing = framing

    def receive(self, data: bytes) -> list[T]:
        found: list[T] = []
        step = self._framing.longest_frame(self._longest)
        for start in range(0, len(data), step):
            self._buffer += data[start : start + step]
            while self._at_sync() and self._take(found):
                pass
        return found

    def _at_sync(self) -> bool:
        sync, buffer = self._framing.sync, self._buffer
        start = buffer.find(sync)
        if start < 0:
            kept = next(n for n in range(len(sync) - 1, -1, -1) if buffer.endswith(sync[:n]))
            self._skip(len(buffer) - kept)
            return False
        self._skip(start)
        return len(buffer) >= self._framing.head_length

    def _take(self, found: list[T]) -> bool:
        framing, buffer = self._framing, self._buffer
        head = framing.head_length
        length = int.from_bytes(buffer[len(framing.sync) : head], framing.byte_order) - framing.uncounted
        if not 0 < length <= self._longest:
            self._counters.count(Fault.BAD_LENGTH)
            self._counters.frames += 1
            self._skip(1)
            return True
        if len(buffer) < head + length:
            return False
        self._counters.frames += 1
        try:
            found.append(self._read(bytes(buffer[head : head + length])))
        except DecodeError as error:
            self._counters.count(error.fault)
            self._skip(1)
        else:
            self._counters.messages += 1
            del buffer[: head + length]
        return True

    def _skip(self, count: int) -> None:
        self._counters.skipped_bytes += count
        del self._buffer[:count]
