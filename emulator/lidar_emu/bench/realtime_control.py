"""The control of `bench realtime`: the same sleep and the same write at the same instants, and nothing else.

Started as a process; see `realtime_helper`. What it is late by, this machine makes any program late by that sleeps
and writes. It is told once when and what to write, and answers with the path of its pty before.
"""

from __future__ import annotations

import os
import signal
import tty
from array import array

from lidar_emu.bench.realtime_answers import LIFELINE, answer, answer_arrays, next_order
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.realtime import request_realtime

_NEVER = -1
_SECOND_ISOLATED_CORE = 1


def main() -> None:
    """Write until the last shot, or until the lifeline ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    answer(path=os.ttyname(slave), granted=request_realtime(_SECOND_ISOLATED_CORE).granted)
    order = next_order()
    if order is None:
        return
    os.close(slave)  # by now the reader has it open
    payload = b"U" * (order.pop("packet_bytes") - 1) + b"\0"
    clock = Clock()
    instants = write_on_time(clock, master, payload, **order)
    clock.wait(None, [LIFELINE])  # closing the pty would throw away what its reader has not fetched
    answer_arrays(*instants)


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
    """Write when it is due, or not at all when that is past; returns when it woke up and when it had written.

    Both count from the start; -1 where nothing was written. Shots that did not come up any more are left out.
    """
    woke, written = array("q"), array("q")
    due_ns = start_ns + first_due_ns
    for _ in range(count):
        ready, _roomy = clock.wait(due_ns, [LIFELINE, descriptor])
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
