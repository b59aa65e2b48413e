"""What the port process says to its parent: JSON lines into a pipe, for which nothing waits but the end."""

from __future__ import annotations

import json
import os

from lidar_emu.runtime.clock import Clock

_END_LIMIT_NS = 1_000_000_000


class Answers:
    """The writing end of a pipe whose reader may be busy, or gone.

    Args:
        descriptor: of the pipe; set non-blocking here.
        clock: for the end alone.
    """

    def __init__(self, descriptor: int, clock: Clock) -> None:
        os.set_blocking(descriptor, False)
        self._descriptor = descriptor
        self._clock = clock
        self._unsent = b""

    def say(self, **answer: object) -> None:
        """A line that must arrive: kept where there is no room, until `flush` finds some."""
        self._unsent += json.dumps(answer).encode() + b"\n"
        self.flush()

    def mention(self, **answer: object) -> bool:
        """A line that may be lost, so that what is kept stays small: not said while others wait for room.

        Returns:
            Whether it was said.
        """
        if self._unsent:
            return False
        self.say(**answer)
        return True

    def flush(self) -> None:
        """Write as much of what was kept as there is room for."""
        while self._unsent:
            try:
                written = os.write(self._descriptor, self._unsent)
            except BlockingIOError:
                return
            except BrokenPipeError:  # nobody will ever listen
                written = len(self._unsent)
            self._unsent = self._unsent[written:]

    @property
    def writable(self) -> list[int]:
        """Descriptors to wait on before the next `flush`; none where nothing is left."""
        return [self._descriptor] if self._unsent else []

    def end(self) -> None:
        """Give the reader a last second to take what was kept."""
        deadline_ns = self._clock.now_ns() + _END_LIMIT_NS
        while self._unsent and self._clock.now_ns() < deadline_ns:
            self._clock.wait(deadline_ns, [], self.writable)
            self.flush()
