"""A link that never blocks: it takes whole packets or drops them, and is reopened with back-off after a break."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum

from lidar_emu.errors import InputError

_FIRST_RETRY_NS = 100_000_000
_LAST_RETRY_NS = 2_000_000_000
_POLL_NS = 50_000_000
_RETRY_ROOM_NS = 1_000_000


class DeliveryStatus(IntEnum):
    """Delivery status of a packet."""

    SENT = 0
    """Handed to the link in whole."""
    LATE = 1
    """Skipped: it was overdue by more than the limit."""
    DROPPED_FULL = 2
    """The line was still busy with earlier packets."""
    DROPPED_NOBODY = 3
    """No program has the other end of the pty open."""
    DROPPED_BROKEN = 4
    """The link was broken."""
    SUPERSEDED = 5
    """Not sent: a command has changed the shot, and another packet replaces it."""
    SUPPRESSED = 6
    """Not sent: the device sends none in its mode, or a fault has removed the packet."""
    HELD = 7
    """Held back by a fault: it is part of the next packet that is sent."""
    NOT_POLLED = 8
    """Not sent: the host has not asked for it before the next one was due."""


class LinkLostError(Exception):
    """The link broke: the cable was pulled, the interface went down, or the other end has gone."""


class HostAbsentError(InputError):
    """Nobody listens at the address of the port yet."""


COUNTED = ("error_frames", "ignored_frames", "lost_frames")
"""Counted besides data: error frames, ignored frames, frames (or datagrams) lost because they arrived too fast."""


@dataclass
class LinkDiagnostics:
    """Events and counts of a link, besides its data."""

    events: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    """Counts by the names of `COUNTED`."""
    pulse_ns: int | None = None
    """When the last synchronisation pulse began, on the monotonic clock; None: there was none."""


NOTHING = LinkDiagnostics()


@dataclass(frozen=True)
class DriverFeatures:
    """Optional features that a link requests from the driver of its port."""

    granted: tuple[str, ...] = ()
    missing: Mapping[str, str] = field(default_factory=dict)
    """Features that the driver lacks, each with a remedy."""


NO_DRIVER_FEATURES = DriverFeatures()


class PortChannel:
    """An open port. No call blocks; every call but `close` may raise LinkLostError.

    The defaults are those of a port whose other end cannot be sensed, without a descriptor to wait on.
    """

    driver_features = NO_DRIVER_FEATURES

    def __init__(self, description: str) -> None:
        self.description = description
        """Name of the port for the user."""
        self._diagnostics = LinkDiagnostics()

    @property
    def pending(self) -> bool:
        """Whether a packet is partly written."""
        return False

    @property
    def readable(self) -> int | None:
        """Descriptor to wait on for something to `receive`; None: poll from time to time."""
        return None

    @property
    def writable(self) -> int | None:
        """Descriptor to wait on for room; None: try from time to time."""
        return None

    def connected(self) -> bool:
        """Whether the other end is connected, as far as can be known."""
        return True

    def send(self, payload: bytes) -> bool:  # noqa: ARG002
        """Take the whole packet (True) or nothing of it (False: the line is full, or not `connected`)."""
        return False

    def flush(self) -> bool:
        """Complete a packet that was partly written; True if none is left."""
        return True

    def receive(self) -> bytes:
        """Received bytes (CAN: frame records), even if the sender has closed its end since; empty if none."""
        return b""

    def set_pulse(self, level: bool) -> None:
        """Set the line on which the device gives pulses, if the port has one; does not raise."""

    def take_diagnostics(self) -> LinkDiagnostics:
        """Events and counts since the last call; does not raise."""
        if self._diagnostics == NOTHING:
            return NOTHING
        diagnostics, self._diagnostics = self._diagnostics, LinkDiagnostics()
        return diagnostics

    def unread(self) -> int:
        """Bytes taken that have not left the line or, on a pty, were not fetched by its reader."""
        return 0

    def close(self) -> None:
        """Close the port; never raises."""


class Link:
    """A channel, reopened with back-off when it is lost.

    Args:
        open_channel: opens the channel, at the start and after a break.
        absent: name of a port whose other end need not listen yet; None: it must.

    Raises:
        InputError: the port cannot be opened at the start.
    """

    def __init__(self, open_channel: Callable[[], PortChannel], absent: str | None = None) -> None:
        self._open = open_channel
        self._channel: PortChannel | None = None
        try:
            self._channel = open_channel()
        except HostAbsentError:
            if absent is None:
                raise
        self.description = absent or "" if self._channel is None else self._channel.description
        self._was_open = self._channel is not None
        self._connected = True
        self._retry_at_ns = 0
        self._back_off_ns = _FIRST_RETRY_NS
        self._events: list[tuple[int, str]] = []
        self.counts: Counter[str] = Counter()
        """Counts by the names of `COUNTED`, over all the times that the link was open."""
        self.pulse_ns: int | None = None
        """When the last pulse began on the port's pulse line, on the monotonic clock; None: there was none."""

    def send(self, payload: bytes, now_ns: int) -> DeliveryStatus:
        """Send a packet or drop it."""
        channel = self._channel
        if channel is None:
            return DeliveryStatus.DROPPED_BROKEN
        try:
            taken = channel.send(payload)
            if not (taken and self._connected):
                self._is_connected(channel, now_ns)
        except LinkLostError as lost:
            self._lose(str(lost), now_ns)
            return DeliveryStatus.DROPPED_BROKEN
        if not taken:
            return DeliveryStatus.DROPPED_FULL if self._connected else DeliveryStatus.DROPPED_NOBODY
        self._back_off_ns = _FIRST_RETRY_NS
        return DeliveryStatus.SENT

    def receive(self, now_ns: int) -> bytes:
        """Received bytes (CAN: frame records); empty if none, or while the link is broken."""
        if self._channel is None:
            return b""
        try:
            self._is_connected(self._channel, now_ns)
            data = self._channel.receive()
            self._take_diagnostics(self._channel, now_ns)
            return data
        except LinkLostError as lost:
            self._lose(str(lost), now_ns)
            return b""

    def set_pulse(self, level: bool) -> None:
        """Set the line on which the device gives pulses; nothing happens while the link is broken."""
        if self._channel is not None:
            self._channel.set_pulse(level)

    def service(self, now_ns: int) -> None:
        """Complete a partly written packet; reopen a broken link when it is time."""
        if self._channel is None:
            if now_ns >= self._retry_at_ns:
                self._reopen(now_ns)
            return
        try:
            if self._is_connected(self._channel, now_ns):
                self._channel.flush()
            self._take_diagnostics(self._channel, now_ns)
        except LinkLostError as lost:
            self._lose(str(lost), now_ns)

    @property
    def connected(self) -> bool:
        """Whether the other end is connected, as far as is known; `service` finds out."""
        return self._channel is not None and self._connected

    @property
    def driver_features(self) -> DriverFeatures:
        """Optional features of the port's driver."""
        return NO_DRIVER_FEATURES if self._channel is None else self._channel.driver_features

    @property
    def pending(self) -> bool:
        """Whether a packet is partly written."""
        return self._channel is not None and self._channel.pending

    @property
    def unread(self) -> int:
        """Bytes taken that have not left the line or, on a pty, were not fetched by its reader."""
        try:
            return 0 if self._channel is None or not self._connected else self._channel.unread()
        except LinkLostError:
            return 0

    @property
    def readable(self) -> list[int]:
        """Descriptors to wait on for something to receive."""
        # Without a reader a pty's descriptor is readable (hung up) forever.
        descriptor = self._channel.readable if self._channel and self._connected else None
        return [] if descriptor is None else [descriptor]

    @property
    def writable(self) -> list[int]:
        """Descriptors to wait on for room."""
        descriptor = self._channel.writable if self._channel and self._connected else None
        return [] if descriptor is None else [descriptor]

    def wake_ns(self, now_ns: int, needs_room: bool) -> int | None:
        """Latest instant of the next call of `service`; None: not before a descriptor is ready."""
        if self._channel is None:
            return self._retry_at_ns
        if (needs_room or self.pending) and not self.writable:
            return now_ns + _RETRY_ROOM_NS
        return None if self.readable else now_ns + _POLL_NS

    def add_event(self, text: str, now_ns: int) -> None:
        """Add an event of the link."""
        self._events.append((now_ns, text))

    def take_events(self) -> list[tuple[int, str]]:
        """Events of the link since the last call: (monotonic time in ns, text)."""
        events, self._events = self._events, []
        return events

    def close(self) -> None:
        """Close the port."""
        if self._channel is not None:
            self._channel.close()
            self._channel = None

    def _is_connected(self, channel: PortChannel, now_ns: int) -> bool:
        connected = channel.connected()
        if connected != self._connected:
            self._connected = connected
            self.add_event("connected" if connected else "nobody connected", now_ns)
        return connected

    def _take_diagnostics(self, channel: PortChannel, now_ns: int) -> None:
        diagnostics = channel.take_diagnostics()
        if diagnostics is NOTHING:
            return
        self.counts += diagnostics.counts
        if diagnostics.pulse_ns is not None:
            self.pulse_ns = diagnostics.pulse_ns
        for text in diagnostics.events:
            self.add_event(text, now_ns)

    def _lose(self, text: str, now_ns: int) -> None:
        if self._channel is not None:
            self._take_diagnostics(self._channel, now_ns)
        self.close()
        self._connected = True
        self._retry_later(now_ns)
        self.add_event(f"link broken: {text}", now_ns)

    def _reopen(self, now_ns: int) -> None:
        try:
            self._channel = self._open()
        except InputError:
            self._retry_later(now_ns)
        else:
            self.add_event("reopened" if self._was_open else "connected", now_ns)
            self._was_open = True

    def _retry_later(self, now_ns: int) -> None:
        # The back-off restarts only with the next packet sent, so that a port that fails at once adds few events.
        self._retry_at_ns = now_ns + self._back_off_ns
        self._back_off_ns = min(2 * self._back_off_ns, _LAST_RETRY_NS)
