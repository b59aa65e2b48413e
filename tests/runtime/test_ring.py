"""The ring against a deque, at its edges, and seen from two mappings as from two processes."""

from __future__ import annotations

import errno
import os
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidar_emu.errors import RunError
from lidar_emu.runtime.port.exchange import SharedRing

SLOTS, ENTRY_BYTES = 3, 20


@pytest.fixture
def descriptor() -> Iterator[int]:
    descriptor = SharedRing.create(SLOTS, ENTRY_BYTES)
    yield descriptor
    os.close(descriptor)


@given(st.lists(st.one_of(st.none(), st.binary(max_size=ENTRY_BYTES)), max_size=60))
def test_behaves_as_a_bounded_queue(operations: list[bytes | None]) -> None:
    """None takes, bytes put; lists are long enough to go round several times."""
    descriptor = SharedRing.create(SLOTS, ENTRY_BYTES)
    expected: deque[bytes] = deque()
    try:
        with SharedRing(descriptor) as producer, SharedRing(descriptor) as consumer:
            for entry in operations:
                if entry is None:
                    assert consumer.pop() == (expected.popleft() if expected else None)
                else:
                    assert producer.push(entry) == (len(expected) < SLOTS)
                    if len(expected) < SLOTS:
                        expected.append(entry)
                assert len(producer) == len(consumer) == len(expected)
    finally:
        os.close(descriptor)


def test_an_entry_longer_than_a_slot_is_an_error(descriptor: int) -> None:
    with SharedRing(descriptor) as ring:
        with pytest.raises(ValueError, match="do not fit"):
            ring.push(bytes(ENTRY_BYTES + 5))
        assert ring.pop() is None


def test_an_entry_that_is_not_yet_visible_is_not_delivered(descriptor: int) -> None:
    """As on a processor that makes the head visible first: the slot still holds what was there before."""
    with SharedRing(descriptor) as ring:
        for _ in range(SLOTS):  # the very same bytes, one lap earlier
            ring.push(b"same")
        for _ in range(SLOTS):
            assert ring.pop() == b"same"
        before = os.pread(descriptor, 4096, 0)
        ring.push(b"same")
        after = os.pread(descriptor, 4096, 0)
        head_bytes = 8
        os.pwrite(descriptor, before[head_bytes:], head_bytes)
        assert len(ring) == 1
        assert ring.pop() is None
        os.pwrite(descriptor, after, 0)
        assert ring.pop() == b"same"


def test_memory_that_the_system_does_not_give_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """As under `ulimit -f`, which holds for memory without a name too."""

    def refuse(*_: int) -> None:
        raise OSError(errno.EFBIG, "File too large")

    monkeypatch.setattr(os, "ftruncate", refuse)
    before = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.raises(
        RunError, match="memory of 992 bytes that model and port share: File too large; raise "
    ):
        SharedRing.create(slots=4, entry_bytes=192)
    assert len(list(Path("/proc/self/fd").iterdir())) == before
