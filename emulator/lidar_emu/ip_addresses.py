"""Internet addresses as users write them: ADDRESS, HOST:PORT, and [ADDRESS]:PORT for IPv6."""

from __future__ import annotations

from ipaddress import ip_address
from typing import NamedTuple


class Endpoint(NamedTuple):
    """An address or host name without brackets, and a port; None: any port."""

    host: str
    port: int | None


def endpoint(text: str) -> Endpoint:
    """The endpoint that a text denotes.

    Raises:
        ValueError: the port is not a number from 1 to 65535.
    """
    host, colon, port = text.rpartition(":")
    if not colon or text.endswith("]") or (":" in host and not host.endswith("]")):
        return Endpoint(text.strip("[]"), None)
    if not 0 < int(port) < 1 << 16:  # the system would take it modulo 65536
        raise ValueError("ports are 1 to 65535")
    return Endpoint(host.strip("[]"), int(port))


def is_address(text: str) -> bool:
    """Whether a text is an IP address, with or without a port."""
    try:
        ip_address(endpoint(text).host)
    except ValueError:
        return False
    return True


def is_this_machine(host: str) -> bool:
    """Whether a host is reachable from this machine alone."""
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False
