"""A ring of entries in memory that two processes share: one writes, one reads, neither waits."""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
from typing import Self
from zlib import crc32

from lidar_emu.errors import RunError, reason_of

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
