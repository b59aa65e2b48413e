"""Datagram sockets by address, bound or connected."""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import Any

Join = Callable[[socket.socket, Any], None]
"""`socket.socket.bind` or `socket.socket.connect`."""


def udp_socket(host_and_port: str, join: Join) -> socket.socket:
    """A UDP socket that joins `HOST:PORT`, with an IPv6 host in brackets.

    Raises:
        OSError: there is no such host, or the address cannot be joined.
        ValueError: `host_and_port` has another form.
    """
    host, _, number = host_and_port.rpartition(":")
    port = int(number)
    if not 0 < port < 1 << 16:  # the system would take it modulo 65536
        raise ValueError("ports are 1 to 65535")
    (family, _, _, _, address), *_ = socket.getaddrinfo(host.strip("[]"), port, type=socket.SOCK_DGRAM)
    return datagram_socket(family, address, join)


def datagram_socket(family: int, address: Any, join: Join) -> socket.socket:
    """A datagram socket that joins an address of its family.

    Raises:
        OSError: the address cannot be joined.
    """
    made = socket.socket(family, socket.SOCK_DGRAM)
    try:
        join(made, address)
    except BaseException:
        made.close()
        raise
    return made
