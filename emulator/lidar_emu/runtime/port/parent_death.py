"""What the port's process still does where its parent died: final message on the wire, and a line for the user."""

from __future__ import annotations

import os
from contextlib import suppress

from lidar_emu.runtime.clock import Clock
from lidar_emu.transports.link import DeliveryStatus, Link

_PATIENCE_NS = 500_000_000
_TRY_AGAIN_NS = 1_000_000
_TOLD = {
    DeliveryStatus.SENT: "sent",
    DeliveryStatus.DROPPED_FULL: "not sent: the line is full",
    DeliveryStatus.DROPPED_NOBODY: "not sent: nobody is connected",
    DeliveryStatus.DROPPED_BROKEN: "not sent: the link is broken",
}


def told_of(status: DeliveryStatus) -> str:
    """What became of final message."""
    return _TOLD[status]


def send_final_message(link: Link, words: bytes, clock: Clock) -> DeliveryStatus:
    """Send them after what the line has taken already; a full one is given half a second."""
    gives_up_ns = clock.now_ns() + _PATIENCE_NS
    while True:
        now_ns = clock.now_ns()
        link.service(now_ns)
        status = link.send(words, now_ns)
        if status is not DeliveryStatus.DROPPED_FULL or now_ns >= gives_up_ns:
            return status
        clock.wait(now_ns + _TRY_AGAIN_NS)


def complain(descriptor: int, text: str, clock: Clock) -> None:
    """A line on the standard error that the dead parent had, unless that cannot take it at once."""
    with suppress(OSError):
        if clock.wait(clock.now_ns(), [], [descriptor])[1]:
            os.write(descriptor, f"lidar-emu: {text}\n".encode())
