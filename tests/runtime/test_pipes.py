"""Messages of the port process into a pipe that nobody reads for a while."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence

from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.port.exchange import StatusPipe

SECOND_NS = 1_000_000_000


class ReaderAtLast(Clock):
    """A clock during whose waits somebody reads the pipe, or time passes without."""

    def __init__(self, reader: int | None) -> None:
        self.reader = reader
        self.time_ns = 0
        self.heard = b""

    def now_ns(self) -> int:
        return self.time_ns

    def wait(
        self, until_ns: int | None, readable: Sequence[int] = (), writable: Sequence[int] = ()
    ) -> tuple[list[int], list[int]]:
        assert not readable
        assert until_ns is not None
        if self.reader is None:
            self.time_ns = until_ns
            return [], []
        self.heard += os.read(self.reader, 65536)
        return [], list(writable)


def fill(descriptor: int) -> int:
    """Fill a pipe with empty lines; returns how many."""
    os.set_blocking(descriptor, False)
    count = 0
    for size in (4096, 1):
        while True:
            try:
                count += os.write(descriptor, b"\n" * size)
            except BlockingIOError:
                break
    return count


def test_what_must_arrive_arrives_in_order_though_the_pipe_was_full(pipe: tuple[int, int]) -> None:
    clock = ReaderAtLast(pipe[0])
    status = StatusPipe(pipe[1], clock)
    filled = fill(pipe[1])
    status.send(finished={"sent_bytes": 1})
    assert status.writable == [pipe[1]]
    for number in range(1000):
        status.send_if_idle(event=[number, 0, "flap"])
    status.send(stopped={"sent_bytes": 1})
    status.close()
    assert status.writable == []
    os.set_blocking(pipe[0], False)
    heard = clock.heard + os.read(pipe[0], 65536)
    reported = [json.loads(line) for line in heard[filled:].splitlines()]
    assert reported == [{"finished": {"sent_bytes": 1}}, {"stopped": {"sent_bytes": 1}}]


def test_a_line_longer_than_the_pipe_arrives_in_parts(pipe: tuple[int, int]) -> None:
    clock = ReaderAtLast(pipe[0])
    status = StatusPipe(pipe[1], clock)
    text = "x" * 300_000
    status.send(ready=text)
    assert status.writable
    status.close()
    os.set_blocking(pipe[0], False)
    while not clock.heard.endswith(b"\n"):
        clock.heard += os.read(pipe[0], 65536)
    assert json.loads(clock.heard) == {"ready": text}


def test_a_parent_that_never_listens_holds_nobody_up_for_long(pipe: tuple[int, int]) -> None:
    clock = ReaderAtLast(None)
    status = StatusPipe(pipe[1], clock)
    fill(pipe[1])
    status.send(stopped={})
    status.close()
    assert clock.time_ns == SECOND_NS


def test_a_parent_that_is_gone_is_not_reported() -> None:
    reader, writer = os.pipe()
    status = StatusPipe(writer, ReaderAtLast(None))
    os.close(reader)
    status.send(finished={})
    assert status.writable == []
    os.close(writer)
