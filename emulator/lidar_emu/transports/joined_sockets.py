"""Sockets by address, bound or connected."""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import Any

from lidar_emu.ip_addresses import endpoint

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
