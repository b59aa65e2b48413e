"""UDP: a datagram per packet, framed as on a byte link, so that a bridge can pass it on to a UART as it is.

The device exchanges datagrams with one address only; the host binds that address and answers the last sender.
Sources: udp(7), ip(7), socket(7).
"""

from __future__ import annotations

import errno
import socket
from typing import Any

from lidar_emu.errors import InputError, reason_of
from lidar_emu.transports.byte_channel import queued_bytes
from lidar_emu.transports.can_adapters import count_losses, enlarge_receive_buffer
from lidar_emu.transports.link import LinkLostError, PortChannel
from lidar_emu.transports.sockets import udp_socket
from lidar_emu.transports.spec import PortSpec

_LONGEST_BYTES = 65536
_AT_ONCE = 16
_FULL = (errno.EAGAIN, errno.ENOBUFS)
_NOBODY = (errno.ECONNREFUSED, errno.EHOSTUNREACH, errno.EHOSTDOWN)


class UdpChannel(PortChannel):
    """The device's end: a socket that is connected to its peer, so that the system drops datagrams of all others.

    The system reports an unreceived datagram if the other machine does: at once on this machine, by the next packet
    across a network, never through a silent firewall. Each packet is sent in any case.
    """

    def __init__(self, sock: socket.socket, description: str) -> None:
        super().__init__(description)
        self._socket = sock
        self._connected = True
        self._lost = 0
        sock.setblocking(False)
        enlarge_receive_buffer(sock)

    @property
    def readable(self) -> int | None:
        return self._socket.fileno()

    @property
    def writable(self) -> int | None:
        return self._socket.fileno()

    def connected(self) -> bool:
        self._connected &= not self._refused()
        return self._connected

    def send(self, payload: bytes) -> bool:
        refused_before = self._refused()
        try:
            self._put(payload)
        except OSError as error:
            return self._not_sent(error)
        refused_now = self._refused()
        self._connected = not (refused_before or refused_now)
        return not refused_now

    def receive(self) -> bytes:
        arrived: list[bytes] = []
        for _ in range(_AT_ONCE):
            try:
                arrived.append(self._get())
            except BlockingIOError:
                break
            except OSError as error:
                self._not_sent(error)
        if arrived:  # even an empty one
            self._connected = True
            self._lost = count_losses(self._socket, self._lost, self._diagnostics, "datagrams")
        return b"".join(arrived)

    def unread(self) -> int:
        return queued_bytes(self._socket.fileno())

    def close(self) -> None:
        self._socket.close()

    def _put(self, payload: bytes) -> None:
        self._socket.send(payload)

    def _get(self) -> bytes:
        return self._socket.recv(_LONGEST_BYTES)

    def _refused(self) -> bool:
        """Whether the system reports, since the last call, that a packet found no receiver."""
        return self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) in _NOBODY

    def _not_sent(self, error: OSError) -> bool:
        """Return False if only the packet is lost; raise if the link is."""
        if error.errno in _NOBODY:
            self._connected = False
        elif error.errno not in _FULL:
            raise LinkLostError(error.strerror or str(error)) from None
        return False


class UdpHostChannel(UdpChannel):
    """The host's end: receives from every sender, and answers the last one."""

    def __init__(self, sock: socket.socket, description: str) -> None:
        super().__init__(sock, description)
        self._peer: Any = None

    def _put(self, payload: bytes) -> None:
        if self._peer is None:
            raise ConnectionRefusedError(errno.ECONNREFUSED, "nothing has been received yet")
        self._socket.sendto(payload, self._peer)

    def _get(self) -> bytes:
        data, self._peer = self._socket.recvfrom(_LONGEST_BYTES)
        return data


def open_udp(spec: PortSpec, is_host: bool = False) -> UdpChannel:
    """The device's end, which sends to the address that `spec` names, or the host's, which binds it.

    Raises:
        InputError: there is no such address, or no route to it; for a host, it is not one of this machine's, or in use.
    """
    try:
        if is_host:
            return UdpHostChannel(udp_socket(spec.path, socket.socket.bind), str(spec))
        return UdpChannel(udp_socket(spec.path, socket.socket.connect), str(spec))
    except (OSError, ValueError) as error:
        raise InputError("--port", None, str(spec), f"it cannot be opened: {reason_of(error)}") from None
