"""What the port's process still does where its parent died: last words on the wire, and a line for the user."""

from __future__ import annotations

import os
from contextlib import suppress

from lidar_emu.runtime.clock import Clock
from lidar_emu.transports.link import Fate, Link

_PATIENCE_NS = 500_000_000
_TRY_AGAIN_NS = 1_000_000
_TOLD = {
    Fate.SENT: "sent",
    Fate.DROPPED_FULL: "not sent: the line is full",
    Fate.DROPPED_NOBODY: "not sent: nobody is connected",
    Fate.DROPPED_BROKEN: "not sent: the link is broken",
}


def told_of(fate: Fate) -> str:
    """What became of last words."""
    return _TOLD[fate]


def say_last_words(link: Link, words: bytes, clock: Clock) -> Fate:
    """Send them after what the line has taken already; a full one is given half a second."""
    gives_up_ns = clock.now_ns() + _PATIENCE_NS
    while True:
        now_ns = clock.now_ns()
        link.service(now_ns)
        fate = link.send(words, now_ns)
        if fate is not Fate.DROPPED_FULL or now_ns >= gives_up_ns:
            return fate
        clock.wait(now_ns + _TRY_AGAIN_NS)


def complain(descriptor: int, text: str, clock: Clock) -> None:
    """A line on the standard error that the dead parent had, unless that cannot take it at once."""
    with suppress(OSError):
        if clock.wait(clock.now_ns(), [], [descriptor])[1]:
            os.write(descriptor, f"lidar-emu: {text}\n".encode())
