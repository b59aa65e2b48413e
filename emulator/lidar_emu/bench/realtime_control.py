"""The control process of `bench realtime`: the same sleep and the same write at the same instants, and nothing else.

A helper process; see `helper_process`. Its lateness is the lateness of any program on this machine that sleeps and
writes. It sends the path of its pty, and then receives schedule and payload.
"""

from __future__ import annotations

import os
import signal
import tty
from array import array

from lidar_emu.bench.helper_pipes import CONTROL, receive_message, send_arrays, send_message
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.realtime_priority import request_realtime

_NEVER = -1
_SECOND_ISOLATED_CORE = 1


def main() -> None:
    """Write until the last shot, or until the control pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    send_message(path=os.ttyname(slave), granted=request_realtime(_SECOND_ISOLATED_CORE).granted)
    message = receive_message()
    if message is None:
        return
    os.close(slave)  # the reader has it open by now
    payload = b"U" * (message.pop("packet_bytes") - 1) + b"\0"
    clock = Clock()
    instants = write_on_time(clock, master, payload, **message)
    clock.wait(None, [CONTROL])  # closing the pty would discard bytes that its reader has not fetched
    send_arrays(*instants)


def write_on_time(
    clock: Clock,
    descriptor: int,
    payload: bytes,
    start_ns: int,
    first_due_ns: int,
    period_ns: int,
    count: int,
    late_after_ns: int,
) -> tuple[array[int], array[int]]:
    """Write when due, or not at all if it is too late; return when it woke up and when it had written.

    Both count from the start; -1 where nothing was written. Shots after an early end are left out.
    """
    woke, written = array("q"), array("q")
    due_ns = start_ns + first_due_ns
    for _ in range(count):
        ready, _roomy = clock.wait(due_ns, [CONTROL, descriptor])
        if ready:
            break
        woke_ns = clock.now_ns()
        written_ns = _NEVER
        if woke_ns <= due_ns + late_after_ns:
            try:
                os.write(descriptor, payload)
                written_ns = clock.now_ns() - start_ns
            except BlockingIOError:
                pass  # the reader has not kept up
        woke.append(woke_ns - start_ns)
        written.append(written_ns)
        due_ns += period_ns
    return woke, written


if __name__ == "__main__":
    main()
