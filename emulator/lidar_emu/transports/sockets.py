"""Sockets: streams of a port, TCP and Unix, and datagrams of truth and of faults to inject.

On a stream the device listens at its address and serves one host at a time.

Sources: tcp(7), unix(7).
"""

from __future__ import annotations

import socket
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Self, TypeVar

from lidar_emu.errors import InputError, reason_of
from lidar_emu.ip_addresses import endpoint
from lidar_emu.transports.byte_channel import DescriptorChannel
from lidar_emu.transports.link import LinkLostError, PortChannel
from lidar_emu.transports.spec import Kind, PortSpec

Join = Callable[[socket.socket, Any], None]
"""`socket.socket.bind` or `socket.socket.connect`."""


def udp_socket(host_and_port: str, join: Join) -> socket.socket:
    """A UDP socket that joins `HOST:PORT`, with an IPv6 host in brackets.

    Raises:
        OSError: there is no such host, or the address cannot be joined.
        ValueError: `host_and_port` has another form.
    """
    host, port = endpoint(host_and_port)
    (family, _, _, _, address), *_ = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
    return joined_socket(family, socket.SOCK_DGRAM, address, join)


def joined_socket(family: int, kind: int, address: Any, join: Join) -> socket.socket:
    """A socket of a kind, `socket.SOCK_DGRAM` or `SOCK_STREAM`, that joins an address of its family.

    Raises:
        OSError: the address cannot be joined.
    """
    made = socket.socket(family, kind)
    try:
        join(made, address)
    except BaseException:
        made.close()
        raise
    return made


def remove_abandoned(path: str) -> None:
    """Remove a socket's path that a process which has ended has left."""
    if _is_abandoned(path):
        Path(path).unlink()


def _is_abandoned(path: str) -> bool:
    """Whether the path is the socket, of datagrams or a stream, of a process that has ended."""
    try:
        if not stat.S_ISSOCK(Path(path).stat().st_mode):
            return False
        # A live stream refuses a datagram socket by its type, and does not notice.
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as trial:
            trial.connect(path)
    except ConnectionRefusedError:
        return True
    except OSError:
        return False
    return False


_CONNECT_TIMEOUT_S = 1.0

T = TypeVar("T")


class ListeningChannel(PortChannel):
    """The device's end. A second host waits until the first one has gone, and then starts with a whole packet."""

    def __init__(self, listener: socket.socket, description: str) -> None:
        super().__init__(description)
        self._listener = listener
        listener.setblocking(False)
        self._nobody = self._host = PortChannel(description)

    @property
    def pending(self) -> bool:
        return self._host.pending

    @property
    def readable(self) -> int | None:
        return self._host.readable

    @property
    def writable(self) -> int | None:
        return self._host.writable

    def connected(self) -> bool:
        if self._host is self._nobody:
            with suppress(BlockingIOError, ConnectionError):
                connection, _ = self._listener.accept()
                if connection.family != socket.AF_UNIX:
                    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._host = DescriptorChannel(connection.fileno(), self.description, connection.close)
        return self._host is not self._nobody

    def send(self, payload: bytes) -> bool:
        self.connected()
        return self._unless_lost(lambda: self._host.send(payload), False)

    def flush(self) -> bool:
        return self._unless_lost(self._host.flush, True)

    def receive(self) -> bytes:
        return self._unless_lost(self._host.receive, b"")

    def unread(self) -> int:
        return self._host.unread()

    def close(self) -> None:
        self._lose_host()
        address = self._listener.getsockname()
        self._listener.close()
        if isinstance(address, str):
            Path(address).unlink(missing_ok=True)

    def _unless_lost(self, call: Callable[[], T], otherwise: T) -> T:
        try:
            return call()
        except LinkLostError:
            self._lose_host()
            return otherwise

    def _lose_host(self) -> None:
        self._host.close()
        self._host = self._nobody


def open_listening(spec: PortSpec) -> ListeningChannel:
    """The device's end of a stream socket.

    Raises:
        InputError: the address is not one of this machine's, or is in use.
    """
    try:
        if spec.kind is Kind.UNIX:
            remove_abandoned(spec.path)
            listener = joined_socket(socket.AF_UNIX, socket.SOCK_STREAM, spec.path, socket.socket.bind)
            listener.listen()
        else:
            address = endpoint(spec.path)
            family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
            listener = socket.create_server(address, family=family)
    except OSError as error:
        raise InputError("--port", None, str(spec), f"it cannot be opened: {reason_of(error)}") from None
    return ListeningChannel(listener, str(spec))


def open_stream_host(spec: PortSpec) -> DescriptorChannel:
    """The host's end: connects to the device.

    Raises:
        InputError: no device listens there.
    """
    try:
        if spec.kind is Kind.UNIX:
            connection = joined_socket(socket.AF_UNIX, socket.SOCK_STREAM, spec.path, socket.socket.connect)
        else:
            connection = socket.create_connection(endpoint(spec.path), _CONNECT_TIMEOUT_S)
    except OSError as error:
        raise InputError("--port", None, str(spec), f"it cannot be opened: {reason_of(error)}") from None
    return DescriptorChannel(connection.fileno(), str(spec), connection.close)


AT_ONCE = 64
_LONGEST_BYTES = 65536


class DatagramSocket:
    """A bound datagram socket, UDP or Unix.

    Args:
        address: `udp:HOST:PORT` or `unix:PATH`; the path of a dead process is taken over.
        now_ns: instant of the monotonic clock.

    Raises:
        OSError: the address cannot be bound.
        ValueError: `address` has another form.
    """

    def __init__(self, address: str, now_ns: Callable[[], int]) -> None:
        self._now_ns = now_ns
        kind, _, place = address.partition(":")
        self._path = place if kind == "unix" else None
        if self._path is None:
            self._socket = udp_socket(place, socket.socket.bind)
        else:
            remove_abandoned(place)
            self._socket = joined_socket(socket.AF_UNIX, socket.SOCK_DGRAM, place, socket.socket.bind)
        self._socket.setblocking(False)

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
            arrived.append((data, self._now_ns(), sender))
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
