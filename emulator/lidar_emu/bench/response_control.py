"""The control process of `bench response`: writes as many bytes to a pty for each datagram, and nothing else.

A process; see `helper_process`.
"""

from __future__ import annotations

import os
import signal
import socket
import tty
from array import array

from lidar_emu.bench.helper_pipes import CONTROL, receive_message, send_arrays, send_message
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.realtime_priority import request_realtime

_NEVER = -1


def main() -> None:
    """Write until the control pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    send_message(path=os.ttyname(slave), granted=request_realtime(1).granted)
    order = receive_message()
    if order is None:
        return
    os.close(slave)
    link = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    link.bind(order["address"])
    send_message(open=True)
    send_arrays(_write(Clock(), link, master, b"U" * order["packet_bytes"]))


def _write(clock: Clock, link: socket.socket, descriptor: int, payload: bytes) -> array[int]:
    """Instants at which each write returned, on the monotonic clock."""
    written = array("q")
    while True:
        ready, _ = clock.wait(None, [link.fileno(), CONTROL])
        if link.fileno() not in ready:
            return written
        link.recv(65536)
        try:
            os.write(descriptor, payload)
            written.append(clock.now_ns())
        except BlockingIOError:
            written.append(_NEVER)


if __name__ == "__main__":
    main()
