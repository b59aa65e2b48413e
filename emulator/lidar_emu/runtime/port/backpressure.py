"""How long a packet waits for a link that does not take it, where the link sets the pace."""

from __future__ import annotations

from typing import Protocol

from lidar_emu.transports.link import DeliveryStatus

_TELL_AFTER_NS = 5_000_000_000
_GIVE_UP_AFTER_NS = 30_000_000_000
_NOTHING_TAKEN = "the line has taken nothing for"


class BlockedLink(Protocol):
    """Whose refusals are borne: a `Link`."""

    @property
    def unread(self) -> int:
        """Bytes that the other end has yet to fetch."""

    def note(self, text: str, now_ns: int) -> None:
        """Add to what happened to the link."""


class BackpressurePolicy:
    """Decides for each packet that the link did not take whether to wait or to drop it; see `Pace.MAX`.

    Its clock starts anew with every packet taken, and whenever the other end has fetched something: a slow
    line may have no room for seconds, and yet work.
    """

    def __init__(self, link: BlockedLink) -> None:
        self._link = link
        self._somebody_came = False
        self._standstill: tuple[DeliveryStatus, int] | None = None
        self._since_ns = 0
        self._told_ns = 0

    def wait_until(self, status: DeliveryStatus, now_ns: int) -> int | None:
        """Until when to wait before the packet is tried again; None: its delivery status is final.

        Args:
            status: of the packet.
            now_ns: instant of the monotonic clock.
        """
        self._somebody_came |= status in (DeliveryStatus.SENT, DeliveryStatus.DROPPED_FULL)
        waited_for = status is DeliveryStatus.DROPPED_FULL or (
            status is DeliveryStatus.DROPPED_NOBODY and not self._somebody_came
        )
        if not waited_for:
            self._standstill = None
            return None
        standstill = status, self._link.unread
        if standstill != self._standstill:
            self._standstill, self._since_ns, self._told_ns = standstill, now_ns, 0
        stood_ns = now_ns - self._since_ns
        if status is DeliveryStatus.DROPPED_FULL:
            self._tell(stood_ns, now_ns)
        if stood_ns >= _GIVE_UP_AFTER_NS:
            return None
        limit_ns = _TELL_AFTER_NS if stood_ns < _TELL_AFTER_NS else _GIVE_UP_AFTER_NS
        return self._since_ns + limit_ns

    def _tell(self, stood_ns: int, now_ns: int) -> None:
        """Each of the two limits once."""
        for limit_ns, consequence in ((_TELL_AFTER_NS, ""), (_GIVE_UP_AFTER_NS, ": packets are dropped")):
            if self._told_ns < limit_ns <= stood_ns:
                self._told_ns = limit_ns
                self._link.note(f"{_NOTHING_TAKEN} {limit_ns // 10**9} s{consequence}", now_ns)
