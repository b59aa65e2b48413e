"""The wait for the other end of a port to open it."""

from __future__ import annotations

from collections.abc import Callable

from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.port.runner import PortRunner

_SETTLED_NS = 100_000_000
"""A program that only sets the terminal (`stty`) closes the port sooner than that."""
_POLL_NS = 20_000_000


def wait_for_host(port: PortRunner, clock: Clock, may_wait: Callable[[], bool]) -> bool:
    """Wait until the other end has had the port open for a tenth of a second.

    Args:
        port: the open port.
        clock: the clock.
        may_wait: called again and again; False ends the wait.

    Returns:
        Whether the host is there; False: the wait was ended.

    Raises:
        PortDiedError: the port process died.
    """
    since_ns: int | None = None
    while may_wait():
        now_ns = clock.now_ns()
        if not port.status.connected:
            since_ns = None
        elif since_ns is None:
            since_ns = now_ns
        elif now_ns - since_ns >= _SETTLED_NS:
            return True
        port.wait(now_ns + _POLL_NS)
    return False
