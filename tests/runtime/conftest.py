"""What the tests of the port process share: a reader on a pty."""

from __future__ import annotations

import os
import select
import threading
from collections.abc import Iterator
from contextlib import suppress

import pytest


class PtyReader:
    """Reads a pty by its path until it goes away or `stop` is called; `data` is what came."""

    def __init__(self, path: str) -> None:
        self.data = b""
        self.descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._stop_out, self._stop = os.pipe()
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def stop(self) -> None:
        os.write(self._stop, b"\0")
        self._thread.join()
        for descriptor in (self.descriptor, self._stop, self._stop_out):
            os.close(descriptor)

    def _read(self) -> None:
        while True:
            ready = select.select([self.descriptor, self._stop_out], [], [])[0]
            with suppress(BlockingIOError, OSError):
                if data := os.read(self.descriptor, 65536):
                    self.data += data
                    continue
            if self._stop_out in ready or self.descriptor in ready:
                return


@pytest.fixture
def pty_reader() -> type[PtyReader]:
    """See `PtyReader`."""
    return PtyReader


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    """Its reading and its writing end."""
    ends = os.pipe()
    yield ends
    for descriptor in ends:
        os.close(descriptor)
