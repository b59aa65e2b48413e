"""What the port process does when the model process dies: a final message on the link, and a line for the user."""

from __future__ import annotations

import os
from contextlib import suppress

from lidar_emu.runtime.clock import Clock
from lidar_emu.transports.link import DeliveryStatus, Link

_FULL_LINE_LIMIT_NS = 500_000_000
_RETRY_NS = 1_000_000
_RESULTS = {
    DeliveryStatus.SENT: "sent",
    DeliveryStatus.DROPPED_FULL: "not sent: the line is full",
    DeliveryStatus.DROPPED_NOBODY: "not sent: nobody is connected",
    DeliveryStatus.DROPPED_BROKEN: "not sent: the link is broken",
}


def result_text(status: DeliveryStatus) -> str:
    """The delivery status of the final message, for the user."""
    return _RESULTS[status]


def send_final_message(link: Link, message: bytes, clock: Clock) -> DeliveryStatus:
    """Send the final message after what the line has taken already; a full line gets half a second."""
    gives_up_ns = clock.now_ns() + _FULL_LINE_LIMIT_NS
    while True:
        now_ns = clock.now_ns()
        link.service(now_ns)
        status = link.send(message, now_ns)
        if status is not DeliveryStatus.DROPPED_FULL or now_ns >= gives_up_ns:
            return status
        clock.wait(now_ns + _RETRY_NS)


def write_error(descriptor: int, text: str, clock: Clock) -> None:
    """Write a line to the standard error of the dead process, unless that would have to wait."""
    with suppress(OSError):
        if clock.wait(clock.now_ns(), [], [descriptor])[1]:
            os.write(descriptor, f"lidar-emu: {text}\n".encode())
