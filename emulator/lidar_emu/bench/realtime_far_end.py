"""The reader at the far end of a pty: notes when each packet was there. A process; see `realtime_helper`."""

from __future__ import annotations

import os
import signal
from array import array

from lidar_emu.bench.realtime_answers import LIFELINE, answer, answer_arrays, next_order
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.realtime import request_realtime

_READ_BYTES = 65536
_THIRD_ISOLATED_CORE = 2


def main() -> None:
    """Read until the other end is closed, or until the lifeline ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answer(ready=True)
    order = next_order()
    if order is None:
        return
    descriptor = os.open(order["path"], os.O_RDWR | os.O_NOCTTY)
    request_realtime(_THIRD_ISOLATED_CORE)
    answer(open=True)
    answer_arrays(_note_delimiters(Clock(), descriptor))


def _note_delimiters(clock: Clock, descriptor: int) -> array[int]:
    """Instants of the monotonic clock, one for each zero byte: zero is in no packet but at its ends."""
    seen = array("q")
    while True:
        ready, _ = clock.wait(None, [descriptor, LIFELINE])
        if descriptor in ready:
            try:
                data = os.read(descriptor, _READ_BYTES)
            except OSError:  # EIO: the other end was closed
                data = b""
            now_ns = clock.now_ns()
            if not data:
                return seen
            seen.extend([now_ns] * data.count(0))
        elif LIFELINE in ready:
            return seen


if __name__ == "__main__":
    main()
