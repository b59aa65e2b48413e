"""Receiving datagram sockets, for truth from a simulator and for faults to inject."""

from __future__ import annotations

import socket
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from lidar_emu.runtime.clock import Clock
from lidar_emu.transports.stream_socket import joined_socket, remove_abandoned, udp_socket

AT_ONCE = 64
_LONGEST_BYTES = 65536


class DatagramSocket:
    """A bound datagram socket, UDP or Unix.

    Args:
        address: `udp:HOST:PORT` or `unix:PATH`; the path of a dead process is taken over.

    Raises:
        OSError: the address cannot be bound.
        ValueError: `address` has another form.
    """

    def __init__(self, address: str, clock: Clock) -> None:
        self._clock = clock
        self._path: str | None = None
        kind, _, place = address.partition(":")
        self._socket = self._unix(place) if kind == "unix" else udp_socket(place, socket.socket.bind)
        self._socket.setblocking(False)

    def _unix(self, path: str) -> socket.socket:
        remove_abandoned(path)
        bound = joined_socket(socket.AF_UNIX, socket.SOCK_DGRAM, path, socket.socket.bind)
        self._path = path
        return bound

    def fileno(self) -> int:
        """Ready when there is something to receive."""
        return self._socket.fileno()

    def receive(self, most: int = AT_ONCE) -> list[tuple[bytes, int, Any]]:
        """At most `most` datagrams that have arrived, each with the instant of the monotonic clock at which it was read
        and the address of its sender."""
        arrived: list[tuple[bytes, int, Any]] = []
        while len(arrived) < most:
            try:
                data, sender = self._socket.recvfrom(_LONGEST_BYTES)
            except BlockingIOError:
                break
            except ConnectionError:  # an earlier answer found no receiver
                continue
            arrived.append((data, self._clock.now_ns(), sender))
        return arrived

    def answer(self, datagram: bytes, receiver: Any) -> bool:
        """Send a datagram to the address of a sender; False if it cannot be delivered."""
        if not receiver:  # a Unix socket without a name
            return False
        try:
            self._socket.sendto(datagram, receiver)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Release the address."""
        self._socket.close()
        if self._path is not None:
            with suppress(OSError):
                Path(self._path).unlink()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
