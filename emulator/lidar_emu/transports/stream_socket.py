"""Stream sockets, TCP and Unix: the device listens at its address and serves one host at a time.

Sources: tcp(7), unix(7).
"""

from __future__ import annotations

import socket
from contextlib import suppress
from pathlib import Path

from lidar_emu.errors import InputError, reason_of
from lidar_emu.ip_addresses import endpoint
from lidar_emu.transports.byte_channel import DescriptorChannel
from lidar_emu.transports.joined_sockets import joined_socket
from lidar_emu.transports.link import NO_DRIVER_FEATURES, NOTHING, LinkDiagnostics, LinkLostError
from lidar_emu.transports.spec import Kind, PortSpec
from lidar_emu.transports.unix_paths import remove_abandoned

_CONNECT_TIMEOUT_S = 1.0


class ListeningChannel:
    """The device's end. A second host waits until the first one has gone, and then starts with a whole packet.

    Args:
        listener: listens at the address.
        description: name of the link for the user.
    """

    driver_features = NO_DRIVER_FEATURES

    def __init__(self, listener: socket.socket, description: str) -> None:
        self.description = description
        self._listener = listener
        listener.setblocking(False)
        self._host: DescriptorChannel | None = None

    @property
    def pending(self) -> bool:
        """Whether a packet is partly written."""
        return self._host is not None and self._host.pending

    @property
    def readable(self) -> int | None:
        """Descriptor to wait on for something to `receive`; None without a host."""
        return None if self._host is None else self._host.readable

    @property
    def writable(self) -> int | None:
        """Descriptor to wait on for room; None without a host."""
        return None if self._host is None else self._host.writable

    def connected(self) -> bool:
        """Whether there is a host."""
        if self._host is None:
            with suppress(BlockingIOError, ConnectionError):
                connection, _ = self._listener.accept()
                if connection.family != socket.AF_UNIX:
                    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._host = DescriptorChannel(connection.fileno(), self.description, connection.close)
        return self._host is not None

    def send(self, payload: bytes) -> bool:
        """Take the whole packet (True) or nothing of it (False: the line is full, or there is no host)."""
        try:
            return self.connected() and self._host is not None and self._host.send(payload)
        except LinkLostError:
            self._lose_host()
            return False

    def flush(self) -> bool:
        """Complete a packet that was partly written; True if none is left."""
        try:
            return self._host is None or self._host.flush()
        except LinkLostError:
            self._lose_host()
            return True

    def receive(self) -> bytes:
        """Received bytes; empty if none."""
        try:
            return b"" if self._host is None else self._host.receive()
        except LinkLostError:
            self._lose_host()
            return b""

    def take_diagnostics(self) -> LinkDiagnostics:
        """Always empty: a byte link has no diagnostics."""
        return NOTHING

    def unread(self) -> int:
        """Bytes that the host has not acknowledged, with the system's overhead."""
        return 0 if self._host is None else self._host.unread()

    def close(self) -> None:
        """Close the connection and release the address."""
        self._lose_host()
        address = self._listener.getsockname()
        self._listener.close()
        if isinstance(address, str):
            Path(address).unlink(missing_ok=True)

    def _lose_host(self) -> None:
        if self._host is not None:
            self._host.close()
            self._host = None


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
