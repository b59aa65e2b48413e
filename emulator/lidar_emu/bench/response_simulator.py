"""The simulator of `bench response`: sends truth at given instants, and records when.

A process; see `helper_process`.
"""

from __future__ import annotations

import signal
import socket
from array import array
from contextlib import suppress

from lidar_emu.bench.helper_pipes import CONTROL, receive_message, send_arrays, send_message
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.realtime_priority import request_realtime
from lidar_emu.trajectory.live_datagram import Truth

_FACING_DOWN = (0.0, 0.5**0.5, 0.5**0.5, 0.0)


def main() -> None:
    """Send until the last shot, or until the control pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    send_message(ready=True)
    order = receive_message()
    if order is None:
        return
    request_realtime()
    send_arrays(*_send(Clock(), **order))


def _send(
    clock: Clock,
    emulator: str,
    control: str,
    start_ns: int,
    first_sent_ns: int,
    first_truth_ns: int,
    period_ns: int,
    count: int,
    top_m: float,
    speed_mps: float,
) -> tuple[array[int], array[int]]:
    """One truth for each shot to the emulator, and half a period later to the control, where neither is in the other's
    way; returns the instants from the start."""
    link = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    to_emulator, to_control = array("q"), array("q")
    # Before the first shot, so that the run can begin.
    link.sendto(_truth(0, 0, top_m, speed_mps), emulator)
    for shot in range(count):
        due_ns = start_ns + first_sent_ns + shot * period_ns
        for receiver, wait_ns, sent in ((emulator, 0, to_emulator), (control, period_ns // 2, to_control)):
            if clock.wait(due_ns + wait_ns, [CONTROL])[0]:
                return to_emulator, to_control
            datagram = _truth(shot + 1, first_truth_ns + shot * period_ns, top_m, speed_mps)
            sent.append(clock.now_ns() - start_ns)
            with suppress(OSError):  # the receiver has ended
                link.sendto(datagram, receiver)
    clock.wait(None, [CONTROL])
    return to_emulator, to_control


def _truth(sequence: int, time_ns: int, top_m: float, speed_mps: float) -> bytes:
    """Straight down."""
    up_m = top_m - speed_mps * time_ns * 1e-9
    still = (0.0, 0.0, 0.0)
    return Truth(
        sequence, time_ns, (0.0, 0.0, up_m), (0.0, 0.0, -speed_mps), still, _FACING_DOWN, still
    ).to_bytes()


if __name__ == "__main__":
    main()
