"""Senders of truth: which are believed, and how many datagrams of others were ignored."""

from __future__ import annotations

from collections.abc import Sequence
from ipaddress import ip_address
from typing import Any

from lidar_emu.ip_addresses import Endpoint, endpoint


class TruthSenders:
    """Believes the simulators that the scenario allows, or else the sender of the first truth.

    A sender is the address that a datagram socket reports: (host, port, ...), or the path of a Unix socket.

    Args:
        allow: IP addresses, with or without a port; empty: the sender of the first truth alone.
    """

    def __init__(self, allow: Sequence[str]) -> None:
        self._allowed = [endpoint(text) for text in allow]
        self._first: Any = None
        self.ignored = 0
        """Datagrams of senders that are not believed."""

    def believes(self, sender: Any) -> bool:
        """Whether a datagram of this sender counts; counts it otherwise."""
        if self._allowed:
            believed = any(_is_of(sender, allowed) for allowed in self._allowed)
        else:
            believed = self._first is None or sender == self._first
        self.ignored += not believed
        return believed

    def accepted(self, sender: Any) -> None:
        """Note that a truth of this sender was accepted."""
        if self._first is None:
            self._first = sender

    @property
    def believed(self) -> str:
        """Who is believed, for the user."""
        return sender_name(self._first)


def sender_name(sender: Any) -> str:
    """A sender's address for the user, such as 127.0.0.1:5601."""
    if not isinstance(sender, tuple):
        return sender or "a socket without a name"
    host, port = sender[:2]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def _is_of(sender: Any, allowed: Endpoint) -> bool:
    host, port = sender[:2]
    return ip_address(host) == ip_address(allowed.host) and allowed.port in (None, port)
