"""How packets, reports and lines of JSON pass between the model process and the port process: a ring and two pipes.

The model process sends commands through the control pipe; its end of file means that the process has closed it or
died. The port process sends its status through the other pipe, and never waits for a reader.
"""

from __future__ import annotations

import json
import mmap
import os
import struct
import tempfile
from typing import Any, Self
from zlib import crc32

from lidar_emu.errors import RunError, reason_of
from lidar_emu.runtime.clock import Clock

_PIPE_BYTES = 65536
_CLOSING_LIMIT_NS = 1_000_000_000


class ControlPipe:
    """The reading end of the control pipe, in the port process."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        """Ready when there is something to receive."""
        self._buffer = b""

    def receive_first(self) -> dict[str, Any] | None:
        """Wait for the first message; None at the end of file."""
        while b"\n" not in self._buffer:
            data = os.read(self.descriptor, _PIPE_BYTES)
            if not data:
                return None
            self._buffer += data
        line, _, self._buffer = self._buffer.partition(b"\n")
        message: dict[str, Any] = json.loads(line)
        return message

    def receive(self) -> tuple[list[dict[str, Any]], bool]:
        """The messages that have arrived, and whether the pipe is still open."""
        data = os.read(self.descriptor, _PIPE_BYTES)
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        return [json.loads(line) for line in lines], bool(data)


class StatusPipe:
    """The writing end of the status pipe, in the port process.

    Args:
        descriptor: descriptor of the pipe; set non-blocking here.
        clock: limits the wait in `close`.
    """

    def __init__(self, descriptor: int, clock: Clock) -> None:
        os.set_blocking(descriptor, False)
        self._descriptor = descriptor
        self._clock = clock
        self._unsent = b""

    def send(self, **message: object) -> None:
        """Send a message that must arrive; `flush` completes it where the pipe is full."""
        self._unsent += json.dumps(message).encode() + b"\n"
        self.flush()

    def send_if_idle(self, **message: object) -> bool:
        """Send a message that may be lost; False if it is, because earlier messages still wait for room."""
        if self._unsent:
            return False
        self.send(**message)
        return True

    def flush(self) -> None:
        """Write as much of the pending messages as the pipe takes."""
        while self._unsent:
            try:
                written = os.write(self._descriptor, self._unsent)
            except BlockingIOError:
                return
            except BrokenPipeError:  # the reader has closed its end
                written = len(self._unsent)
            self._unsent = self._unsent[written:]

    @property
    def writable(self) -> list[int]:
        """Descriptors to wait on before the next `flush`; empty if no message is pending."""
        return [self._descriptor] if self._unsent else []

    def close(self) -> None:
        """Give the reader one second to take the pending messages."""
        deadline_ns = self._clock.now_ns() + _CLOSING_LIMIT_NS
        while self._unsent and self._clock.now_ns() < deadline_ns:
            self._clock.wait(deadline_ns, [], self.writable)
            self.flush()


_HEAD, _TAIL, _SLOT_BYTES = 0, 8, 16  # in 64-bit words: each index has its own cache line
_SLOTS_AT_BYTE = 192
_WORD = struct.Struct("=Q")
_ENTRY_HEAD = struct.Struct("=II")


class SharedRing:
    """A single-producer, single-consumer ring of byte strings over a shared descriptor.

    The memory has no name, so nothing is left however the processes end. `head` and `tail` count
    entries written and read since the beginning and never wrap. An entry carries a checksum that covers
    its number too: on a processor that makes the head visible before the entry, the reader sees that the
    entry is not yet there, and finds it the next time. Neither locks nor barriers are needed.
    """

    def __init__(self, descriptor: int) -> None:
        """Map the ring that `create` made, here or in another process; the caller still owns the descriptor."""
        self._map = mmap.mmap(descriptor, 0)
        self._view = memoryview(self._map)
        # A native 64-bit view stores an index in one piece; struct with a byte order would write bytes.
        self._words = self._view[:_SLOTS_AT_BYTE].cast("Q")
        self._slot_bytes = self._words[_SLOT_BYTES]
        self._slots = (len(self._map) - _SLOTS_AT_BYTE) // self._slot_bytes

    @staticmethod
    def create(slots: int, entry_bytes: int) -> int:
        """Make the memory of a ring of `slots` entries of at most `entry_bytes`; returns its descriptor.

        Raises:
            RunError: the system does not give the memory.
        """
        slot_bytes = -(-(_ENTRY_HEAD.size + entry_bytes) // 8) * 8
        descriptor = anonymous_file()
        size_bytes = _SLOTS_AT_BYTE + slots * slot_bytes
        try:
            os.ftruncate(descriptor, size_bytes)
        except OSError as error:  # The limit of the size of files (ulimit -f) holds for it too.
            os.close(descriptor)
            what = f"memory of {size_bytes} bytes that model and port share: {reason_of(error)}"
            raise RunError(f"{what}; raise ulimit -f") from None
        os.pwrite(descriptor, _WORD.pack(slot_bytes), _WORD.size * _SLOT_BYTES)
        return descriptor

    def __len__(self) -> int:
        return self._words[_HEAD] - self._words[_TAIL]

    def push(self, entry: bytes) -> bool:
        """Producer: add an entry; False if the ring is full.

        Raises:
            ValueError: the entry is longer than a slot.
        """
        if len(entry) > self._slot_bytes - _ENTRY_HEAD.size:
            raise ValueError(f"{len(entry)} bytes do not fit into a slot of {self._slot_bytes}")
        number = self._words[_HEAD]
        if number - self._words[_TAIL] >= self._slots:
            return False
        start = self._start_of(number)
        self._view[start + _ENTRY_HEAD.size : start + _ENTRY_HEAD.size + len(entry)] = entry
        _ENTRY_HEAD.pack_into(self._view, start, len(entry), _checksum(entry, number))
        self._words[_HEAD] = number + 1
        return True

    def pop(self) -> bytes | None:
        """Consumer: take the oldest entry; None if there is none."""
        number = self._words[_TAIL]
        if self._words[_HEAD] == number:
            return None
        start = self._start_of(number)
        length, checksum = _ENTRY_HEAD.unpack_from(self._view, start)
        if length > self._slot_bytes - _ENTRY_HEAD.size:
            return None
        entry = bytes(self._view[start + _ENTRY_HEAD.size : start + _ENTRY_HEAD.size + length])
        if _checksum(entry, number) != checksum:
            return None
        self._words[_TAIL] = number + 1
        return entry

    @property
    def written(self) -> int:
        """Entries pushed since the beginning."""
        return self._words[_HEAD]

    def skip_to(self, number: int) -> int:
        """Consumer: skip all entries before entry `number`, counted from 0; return how many were skipped."""
        skipped = max(0, number - self._words[_TAIL])
        self._words[_TAIL] += skipped
        return skipped

    def close(self) -> None:
        """Unmap the memory."""
        self._words.release()
        self._view.release()
        self._map.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _start_of(self, number: int) -> int:
        return _SLOTS_AT_BYTE + (number % self._slots) * self._slot_bytes


def _checksum(entry: bytes, number: int) -> int:
    # The start value depends on the number: the checksum of a stale entry never fits.
    return crc32(entry, (number + 1) & 0xFFFFFFFF)


def anonymous_file() -> int:
    """Descriptor of a new file without a name, in memory where the system can."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("lidar-emu")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())
