"""Programs that measure beside a flight: reader, control processes and simulator. They import little.

`helper_process` starts `python -m lidar_emu.bench.helper_programs NAME`. A control process is as late as any program
of this machine that sleeps and writes.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
import tty
from array import array
from contextlib import suppress
from typing import Any

from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.realtime_priority import request_realtime
from lidar_emu.trajectory.live_datagram import Truth

_CONTROL, _PARENT = 0, 1
_NEVER = -1
_FIRST_TRUTH_NS = 50_000_000
_READ_BYTES = 65536
_SECOND_ISOLATED_CORE, _THIRD_ISOLATED_CORE = 1, 2
_FACING_DOWN = (0.0, 0.5**0.5, 0.5**0.5, 0.0)


def pty_reader() -> None:
    """Read the far end of a pty until the other end or the control pipe is closed; send when each packet arrived."""
    _send_message(ready=True)
    order = _receive_message()
    if order is None:
        return
    descriptor = os.open(order["path"], os.O_RDWR | os.O_NOCTTY)
    request_realtime(_THIRD_ISOLATED_CORE)
    _send_message(open=True)
    _send_arrays(_record_delimiters(Clock(), descriptor))


def _record_delimiters(clock: Clock, descriptor: int) -> array[int]:
    """Instants of the monotonic clock, one for each zero byte: zero is in no packet but at its ends."""
    seen = array("q")
    while True:
        ready, _ = clock.wait(None, [descriptor, _CONTROL])
        if descriptor in ready:
            try:
                data = os.read(descriptor, _READ_BYTES)
            except OSError:  # EIO: the other end was closed
                data = b""
            now_ns = clock.now_ns()
            if not data:
                return seen
            seen.extend([now_ns] * data.count(0))
        elif _CONTROL in ready:
            return seen


def realtime_control() -> None:
    """Sleep and write as the flight does, at the same instants, until the last shot or the end of the control pipe."""
    master, order = _open_pty()
    if order is None:
        return
    payload = b"U" * (order.pop("packet_bytes") - 1) + b"\0"
    clock = Clock()
    instants = _write_on_time(clock, master, payload, **order)
    clock.wait(None, [_CONTROL])  # closing the pty would discard bytes that its reader has not fetched
    _send_arrays(*instants)


def _write_on_time(
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
        ready, _roomy = clock.wait(due_ns, [_CONTROL, descriptor])
        if ready:
            break
        woke_ns = clock.now_ns()
        written_ns = _NEVER
        if woke_ns <= due_ns + late_after_ns:
            with suppress(BlockingIOError):  # the reader has not kept up
                os.write(descriptor, payload)
                written_ns = clock.now_ns() - start_ns
        woke.append(woke_ns - start_ns)
        written.append(written_ns)
        due_ns += period_ns
    return woke, written


def response_control() -> None:
    """Write as many bytes for each datagram until the control pipe is closed; send when each write returned."""
    master, order = _open_pty()
    if order is None:
        return
    link = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    link.bind(order["address"])
    _send_message(open=True)
    clock, payload, written = Clock(), b"U" * order["packet_bytes"], array("q")
    while link.fileno() in clock.wait(None, [link.fileno(), _CONTROL])[0]:
        link.recv(_READ_BYTES)
        try:
            os.write(master, payload)
            written.append(clock.now_ns())
        except BlockingIOError:
            written.append(_NEVER)
    _send_arrays(written)


def response_simulator() -> None:
    """Send truth until the last shot, or until the control pipe is closed; send when."""
    _send_message(ready=True)
    order = _receive_message()
    if order is None:
        return
    request_realtime()
    _send_arrays(*_send_truth(Clock(), **order))


def _send_truth(
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
    # Before the first shot, so that the run can begin; any sooner, it would be too far ahead to be believed.
    clock.wait(start_ns - _FIRST_TRUTH_NS, [_CONTROL])
    link.sendto(_truth(0, 0, top_m, speed_mps), emulator)
    for shot in range(count):
        due_ns = start_ns + first_sent_ns + shot * period_ns
        for receiver, wait_ns, sent in ((emulator, 0, to_emulator), (control, period_ns // 2, to_control)):
            if clock.wait(due_ns + wait_ns, [_CONTROL])[0]:
                return to_emulator, to_control
            datagram = _truth(shot + 1, first_truth_ns + shot * period_ns, top_m, speed_mps)
            sent.append(clock.now_ns() - start_ns)
            with suppress(OSError):  # the receiver has ended
                link.sendto(datagram, receiver)
    clock.wait(None, [_CONTROL])
    return to_emulator, to_control


def _truth(sequence: int, time_ns: int, top_m: float, speed_mps: float) -> bytes:
    """Straight down."""
    position_m, velocity_mps = (0.0, 0.0, top_m - speed_mps * time_ns * 1e-9), (0.0, 0.0, -speed_mps)
    still = (0.0, 0.0, 0.0)
    return Truth(sequence, time_ns, position_m, velocity_mps, still, _FACING_DOWN, still).to_bytes()


def _open_pty() -> tuple[int, dict[str, Any] | None]:
    """The master end of a new pty, whose path is sent; and the next message, which comes once a reader has it open."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    _send_message(path=os.ttyname(slave), granted=request_realtime(_SECOND_ISOLATED_CORE).granted)
    order = _receive_message()
    os.close(slave)
    return master, order


def _receive_message() -> dict[str, Any] | None:
    """The next message of the parent; None once the control pipe is closed."""
    line = b""
    while not line.endswith(b"\n"):
        byte = os.read(_CONTROL, 1)
        if not byte:
            return None
        line += byte
    message: dict[str, Any] = json.loads(line)
    return message


def _send_message(**values: object) -> None:
    _write(json.dumps(values).encode() + b"\n")


def _send_arrays(*arrays: array[int]) -> None:
    """Send the last message, the number of arrays, and then the arrays."""
    _send_message(arrays=len(arrays))
    for values in arrays:
        _write(values.tobytes())


def _write(data: bytes) -> None:
    with suppress(BrokenPipeError):  # the parent was killed
        while data:
            data = data[os.write(_PARENT, data) :]


_PROGRAMS = {
    each.__name__: each for each in (pty_reader, realtime_control, response_control, response_simulator)
}

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _PROGRAMS[sys.argv[1]]()
