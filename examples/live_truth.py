"""A minimal dynamics simulator: it flies a descent and sends its true state to an emulated lidar.

Run it beside `lidar-emu run live.yaml`; with the argument `lockstep` beside `lidar-emu run live.yaml --pace lockstep`.
A client needs `truth`, `send` and, in lockstep, `packets_of`; the standard library is sufficient.
"""

import contextlib
import socket
import struct
import sys
import time
from typing import NamedTuple

TRUTH = struct.Struct("<4sHHI4xq3d3d3d4d3d")  # 152 bytes; see docs/live-truth.md
ANSWER, PACKET = struct.Struct("<4sHBBIIq"), struct.Struct("<IIqB7x")
ACCELERATION_KNOWN, LAST = 1, 2
FACING_DOWN = (0.0, 0.5**0.5, 0.5**0.5, 0.0)  # body z down, x north: site_from_body, scalar first


def truth(sequence: int, time_s: float, last: bool) -> bytes:
    """Truth at 1000 m initial height, descending at 40 m/s, decelerating by 0.8 m/s²."""
    up_m, climb_mps, acceleration_mps2 = 1000 - 40 * time_s + 0.4 * time_s**2, -40 + 0.8 * time_s, 0.8
    return TRUTH.pack(
        b"LETR", 1, ACCELERATION_KNOWN | LAST * last, sequence, round(time_s * 1e9),
        0, 0, up_m, 0, 0, climb_mps, 0, 0, acceleration_mps2, *FACING_DOWN, 0, 0, 0,
    )  # fmt: skip


def send(link: socket.socket, datagram: bytes) -> None:
    """Send truth; the receiver may not be listening yet."""
    with contextlib.suppress(ConnectionRefusedError):
        link.send(datagram)


class Packet(NamedTuple):
    """A packet of the reply."""

    shot: int
    due_ns: int
    status: int  # 0: it was sent
    payload: bytes  # as on the link


def packets_of(link: socket.socket, sequence: int) -> list[Packet] | None:
    """Reply to a truth in lockstep: the packets due since the preceding truth; None if it does not arrive."""
    packets, follow = [], None
    while follow != 0:
        try:
            data = link.recv(65536)
        except (TimeoutError, ConnectionRefusedError):
            return None
        _, _, status, more, answered, count, _ = ANSWER.unpack_from(data)
        if answered != sequence:  # Reply to a truth that was sent twice.
            continue
        if follow is not None and more not in (follow - 1, 255):
            return None  # A part of the reply was lost.
        follow = more
        if status:
            raise ValueError(f"truth {sequence} was refused: status {status}")
        start = ANSWER.size
        for _ in range(count):
            length, shot, due_ns, status = PACKET.unpack_from(data, start)
            start += PACKET.size + length
            packets.append(Packet(shot, due_ns, status, data[start - length : start]))
    return packets


def main(lockstep: bool, rate_hz: int = 100, duration_s: int = 48) -> None:
    """Send truth at a steady rate, or as fast as replies arrive."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.connect(("127.0.0.1", 5600))
    link.settimeout(1)
    steps = duration_s * rate_hz
    start_s, received = time.monotonic(), 0
    for step in range(steps + 1):
        datagram = truth(step, step / rate_hz, last=step == steps)
        send(link, datagram)
        if lockstep:
            sent_s = time.monotonic()
            while (packets := packets_of(link, step)) is None:
                if step > 0 and time.monotonic() > sent_s + 10:
                    raise TimeoutError("the lidar no longer replies")
                time.sleep(0.1)
                send(link, datagram)  # The lidar replies to a repeated truth again.
            received += len(packets)
        else:
            time.sleep(max(0.0, start_s + (step + 1) / rate_hz - time.monotonic()))
    print(f"{steps + 1} truths in {time.monotonic() - start_s:.1f} s, {received} packets in the replies")


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main("lockstep" in sys.argv[1:])
