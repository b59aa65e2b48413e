"""What the tests of the port process share: a condition to wait for, and a reader on a pty."""

from __future__ import annotations

import os
import select
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

import pytest

Eventually = Callable[[Callable[[], object]], None]


@pytest.fixture
def eventually() -> Eventually:
    """Wait until a condition of the outside world holds."""

    def wait(condition: Callable[[], object]) -> None:
        deadline_s = time.monotonic() + 20
        while not condition():
            assert time.monotonic() < deadline_s, "it did not happen"
            time.sleep(0.005)

    return wait


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
