"""How much a device listens to: what a host says without end must not keep it from its shots."""

from __future__ import annotations

_BUFFER_BYTES = 4096
_BYTES_PER_S = 16_000
"""A thousand commands a second, which take a tenth of a processor."""


class RateLimiter:
    """A buffer of arrivals that is emptied at a steady rate; what finds no room is not heard."""

    def __init__(self) -> None:
        self._room = float(_BUFFER_BYTES)
        self._last_ns: int | None = None
        self.refused_bytes = 0

    def take(self, size: int, arrived_ns: int) -> int:
        """How many of so many bytes there is room for; instants of the monotonic clock."""
        if self._last_ns is not None:
            emptied = (arrived_ns - self._last_ns) * 1e-9 * _BYTES_PER_S
            self._room = min(_BUFFER_BYTES, self._room + max(0.0, emptied))
        self._last_ns = arrived_ns
        taken = min(size, int(self._room))
        self._room -= taken
        self.refused_bytes += size - taken
        return taken
