"""The reader at the far end of a pty: records when each packet arrived. A helper process; see `helper_process`."""

from __future__ import annotations

import os
import signal
from array import array

from lidar_emu.bench.helper_pipes import CONTROL, receive_message, send_arrays, send_message
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.realtime_priority import request_realtime

_READ_BYTES = 65536
_THIRD_ISOLATED_CORE = 2


def main() -> None:
    """Read until the other end is closed, or until the control pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    send_message(ready=True)
    message = receive_message()
    if message is None:
        return
    descriptor = os.open(message["path"], os.O_RDWR | os.O_NOCTTY)
    request_realtime(_THIRD_ISOLATED_CORE)
    send_message(open=True)
    send_arrays(_record_delimiters(Clock(), descriptor))


def _record_delimiters(clock: Clock, descriptor: int) -> array[int]:
    """Instants of the monotonic clock, one for each zero byte: zero is in no packet but at its ends."""
    seen = array("q")
    while True:
        ready, _ = clock.wait(None, [descriptor, CONTROL])
        if descriptor in ready:
            try:
                data = os.read(descriptor, _READ_BYTES)
            except OSError:  # EIO: the other end was closed
                data = b""
            now_ns = clock.now_ns()
            if not data:
                return seen
            seen.extend([now_ns] * data.count(0))
        elif CONTROL in ready:
            return seen


if __name__ == "__main__":
    main()
