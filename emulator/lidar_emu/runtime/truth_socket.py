"""The socket on which a simulator's truth arrives."""

from __future__ import annotations

import socket
import stat
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from lidar_emu.errors import InputError
from lidar_emu.runtime.clock import Clock

_LONGEST_BYTES = 65536
_AT_ONCE = 64
_ALLOWED = "allowed: udp:HOST:PORT or unix:PATH"


class TruthSocket:
    """A bound datagram socket, UDP or Unix.

    Args:
        address: `udp:HOST:PORT` or `unix:PATH`; a path that a dead process left behind is taken over.

    Raises:
        InputError: it cannot be bound.
    """

    def __init__(self, address: str, clock: Clock) -> None:
        self._clock = clock
        self._path: str | None = None
        kind, _, place = address.partition(":")
        try:
            self._socket = self._unix(place) if kind == "unix" else self._udp(place)
        except (OSError, OverflowError, ValueError) as error:
            why = getattr(error, "strerror", None) or str(error)
            raise InputError("trajectory", "listen", address, f"{why}; {_ALLOWED}") from None
        self._socket.setblocking(False)

    def _udp(self, place: str) -> socket.socket:
        host, _, port = place.rpartition(":")
        if not 0 < int(port) < 1 << 16:  # the system would take it modulo 65536
            raise ValueError("ports are 1 to 65535")
        (family, _, _, _, where), *_ = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_DGRAM)
        return _bound(family, where)

    def _unix(self, path: str) -> socket.socket:
        if _is_abandoned(path):
            Path(path).unlink()
        bound = _bound(socket.AF_UNIX, path)
        self._path = path
        return bound

    def fileno(self) -> int:
        """Ready when there is something to receive."""
        return self._socket.fileno()

    def receive(self, most: int = _AT_ONCE) -> list[tuple[bytes, int, Any]]:
        """Datagrams that have arrived, so many at most, with the instants of the monotonic clock at which they were
        taken, and the addresses that they came from."""
        arrived: list[tuple[bytes, int, Any]] = []
        while len(arrived) < most:
            try:
                data, sender = self._socket.recvfrom(_LONGEST_BYTES)
            except BlockingIOError:
                break
            except ConnectionError:  # an answer found nobody
                continue
            arrived.append((data, self._clock.now_ns(), sender))
        return arrived

    def answer(self, datagram: bytes, receiver: Any) -> bool:
        """To an address that something came from; False if it cannot be delivered."""
        if not receiver:  # a Unix socket without a name
            return False
        try:
            self._socket.sendto(datagram, receiver)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Give the address back."""
        self._socket.close()
        if self._path is not None:
            with suppress(OSError):
                Path(self._path).unlink()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _bound(family: int, where: Any) -> socket.socket:
    made = socket.socket(family, socket.SOCK_DGRAM)
    try:
        made.bind(where)
    except BaseException:
        made.close()
        raise
    return made


def _is_abandoned(path: str) -> bool:
    """Whether the path is a socket that nobody listens to any more."""
    try:
        if not stat.S_ISSOCK(Path(path).stat().st_mode):
            return False
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as trial:
            trial.connect(path)
    except ConnectionRefusedError:
        return True
    except OSError:
        return False
    return False
