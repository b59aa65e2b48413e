"""Backpressure policy: whether a packet that a full line refuses is retried or dropped."""

from __future__ import annotations

from typing import Protocol

from lidar_emu.runtime.port.packets import DeliveryStatus

_WARN_AFTER_NS = 5_000_000_000
_GIVE_UP_AFTER_NS = 30_000_000_000


class PacketLink(Protocol):
    """Where packets go: a `Link`."""

    @property
    def unread(self) -> int:
        """Bytes that the other end has not fetched yet."""

    def send(self, payload: bytes, now_ns: int) -> DeliveryStatus:
        """Take the whole packet or drop it."""

    def add_event(self, text: str, now_ns: int) -> None:
        """Add an event of the link."""


class BackpressurePolicy:
    """Decides for each packet that the link refuses whether to retry or to drop it; see `Pace.MAX`.

    The time limits restart with every packet that the link takes, and whenever the other end has fetched something:
    a slow line may have no room for seconds and still make progress.
    """

    def __init__(self, link: PacketLink) -> None:
        self._link = link
        self._was_connected = False
        self._stalled: tuple[DeliveryStatus, int] | None = None
        self._since_ns = 0
        self._warned_ns = 0

    def retry_until(self, status: DeliveryStatus, now_ns: int) -> int | None:
        """Instant until which to wait before the packet is tried again; None: the status is final.

        Args:
            status: delivery status of the last attempt.
            now_ns: instant of the monotonic clock.
        """
        is_full, no_reader = status is DeliveryStatus.DROPPED_FULL, status is DeliveryStatus.DROPPED_NOBODY
        self._was_connected |= is_full or status is DeliveryStatus.SENT
        if not (is_full or (no_reader and not self._was_connected)):
            self._stalled = None
            return None
        stalled = status, self._link.unread
        if stalled != self._stalled:
            self._stalled, self._since_ns, self._warned_ns = stalled, now_ns, 0
        stalled_ns = now_ns - self._since_ns
        if is_full:
            self._warn(stalled_ns, now_ns)
        if stalled_ns >= _GIVE_UP_AFTER_NS:
            return None
        return self._since_ns + (_WARN_AFTER_NS if stalled_ns < _WARN_AFTER_NS else _GIVE_UP_AFTER_NS)

    def _warn(self, stalled_ns: int, now_ns: int) -> None:
        """Add a link event at each of the two limits, once."""
        for limit_ns, consequence in ((_WARN_AFTER_NS, ""), (_GIVE_UP_AFTER_NS, ": packets are dropped")):
            if self._warned_ns < limit_ns <= stalled_ns:
                self._warned_ns = limit_ns
                self._link.add_event(
                    f"the line has taken nothing for {limit_ns // 10**9} s{consequence}", now_ns
                )
