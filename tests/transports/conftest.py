"""Far ends for the ports under test."""

from __future__ import annotations

import os
import select
import threading
import tty
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import pytest


@dataclass(frozen=True)
class RawPty:
    """A pseudo terminal whose master end is the test's: a serial cable with the test at the other end."""

    master: int
    path: str

    def read(self) -> bytes:
        """All that has arrived."""
        data = b""
        while select.select([self.master], [], [], 0.05)[0]:
            data += os.read(self.master, 65536)
        return data


@pytest.fixture
def raw_pty() -> Iterator[RawPty]:
    """See `RawPty`; its slave end is held open, so that a reopened path is the same port."""
    master, slave = os.openpty()
    tty.setraw(slave)
    yield RawPty(master, os.ttyname(slave))
    for descriptor in (master, slave):
        with suppress(OSError):
            os.close(descriptor)


@pytest.fixture
def pty_pair() -> Iterator[tuple[str, str]]:
    """Paths of two pseudo terminals joined by a cable."""
    ends = [os.openpty() for _ in range(2)]
    for _, slave in ends:
        tty.setraw(slave)
    masters = [master for master, _ in ends]
    stop_out, stop = os.pipe()

    def carry() -> None:
        while True:
            ready = select.select([*masters, stop_out], [], [])[0]
            if stop_out in ready:
                return
            for master in ready:
                data = os.read(master, 4096)
                os.write(masters[1 - masters.index(master)], data)

    thread = threading.Thread(target=carry)
    thread.start()
    yield os.ttyname(ends[0][1]), os.ttyname(ends[1][1])
    os.write(stop, b"\0")
    thread.join()
    for descriptor in (*(end for pair in ends for end in pair), stop_out, stop):
        os.close(descriptor)
