"""Far ends for the ports under test."""

from __future__ import annotations

import os
import select
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
