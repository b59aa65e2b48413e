"""Status of the port and its link, as the port process reports it."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from lidar_emu.errors import InputError
from lidar_emu.transports.link import COUNTED

_KEPT_AT_EACH_END = 10
_COUNTS = (
    "sent_bytes",
    "unread_bytes",
    "received_bytes",
    "rx_overrun_bytes",
    "tx_dropped",
    "pulses",
    "pulse_delay_max_ns",
    *COUNTED,
)


@dataclass(frozen=True)
class LinkEvent:
    """An event of the link."""

    time_ns: int
    """From the start of the run."""
    text: str


def events_to_json(source: str, count: int, events: Sequence[LinkEvent]) -> dict[str, Any]:
    """Events of a `link` or `process`, by the keys of the summary file."""
    return {
        f"{source}_event_count": count,
        f"{source}_events": [{"time_s": event.time_ns * 1e-9, "what": event.text} for event in events],
    }


class EventLog:
    """The first and the last ten events, and the count of all: a link that flaps for hours costs no memory.

    Times are instants of the monotonic clock.
    """

    def __init__(self) -> None:
        self.count = 0
        """Number of events, including those that are not stored."""
        self._first: list[tuple[int, str]] = []
        self._last: deque[tuple[int, str]] = deque(maxlen=_KEPT_AT_EACH_END)

    def add(self, number: int, time_ns: int, text: str) -> None:
        """Add event `number`, counted from 1; missing numbers are events that were lost on the way."""
        self.count = number
        kept = self._first if len(self._first) < _KEPT_AT_EACH_END else self._last
        kept.append((time_ns, text))

    def since(self, start_ns: int) -> list[LinkEvent]:
        """The stored events, with times from `start_ns`."""
        return [LinkEvent(time_ns - start_ns, text) for time_ns, text in (*self._first, *self._last)]


@dataclass
class PortStatus:
    """Status of the port, from the messages of the port process."""

    description: str = ""
    """Name of the port; of a pty, the path that the host opens."""
    connected: bool = False
    """Whether the other end has opened the port, as far as can be known; kept up to date until the run begins."""
    counts: dict[str, int | None] = field(default_factory=lambda: dict.fromkeys(_COUNTS))
    """Bytes sent, of these the ones that the other end had not read when the port closed, as far as can be known, and
    bytes received on the port; received bytes that arrived too fast to be passed on; payloads of `send_now` that the
    link did not take; pulses given, and the largest delay of one; and see `COUNTED`. Known at the end; None if the
    process died before it could report."""
    granted: list[str] = field(default_factory=list)
    """Real-time privileges that the system granted; see `RealtimePrivileges`."""
    missing: dict[str, str] = field(default_factory=dict)
    """Privileges that it refused, each with the command that grants it."""
    finished: bool = False
    """Every packet has its report, and what was sent has left the line or was read."""
    start_ns: int = 0
    """Instant of the monotonic clock from which the times of events count: scenario time 0, or the opening of the port
    as long as no flight has begun."""
    _events: EventLog = field(default_factory=EventLog)
    _new_events: list[tuple[int, str]] = field(default_factory=list)
    _new_between_ns: list[int | None] = field(default_factory=list)

    @property
    def events(self) -> list[LinkEvent]:
        """Events of the link so far: of more than 20 events the first and the last ten."""
        return self._events.since(self.start_ns)

    def take_events(self) -> list[LinkEvent]:
        """Events since the last call, with times from the start of the run; from the opening of the port before it."""
        events, self._new_events = self._new_events, []
        return [LinkEvent(time_ns - self.start_ns, text) for time_ns, text in events]

    def take_between_ns(self) -> list[int | None]:
        """Times at which payloads of `send_now` were sent since the last call, in their order; None: not sent."""
        times_ns, self._new_between_ns = self._new_between_ns, []
        return [None if time_ns is None else time_ns - self.start_ns for time_ns in times_ns]

    def to_json(self, load: float | None) -> dict[str, Any]:
        """The status, by the keys of the summary file.

        Args:
            load: share of the link's capacity that the shots take.
        """
        return {
            "granted": self.granted,
            "missing": self.missing,
            "wire": {"load": load, **self.counts},
            **events_to_json("link", self._events.count, self.events),
        }

    def update(self, message: dict[str, Any]) -> None:
        """Update the status from a message of the port process.

        Raises:
            InputError: the process could not open the port.
        """
        match message:
            case {"refused": refusal}:
                raise InputError(*refusal)
            case {"ready": description}:
                self.description = description
            case {"connected": connected}:
                self.connected = connected
            case {"granted": granted, "missing": missing}:
                self.granted, self.missing = granted, missing
            case {"between": times_ns}:
                self._new_between_ns += times_ns
            case {"event": [number, time_ns, text]}:
                self._events.add(number, time_ns, text)
                self._new_events.append((time_ns, text))
            case {"finished": counts} | {"stopped": counts}:
                self.finished, self.counts = True, counts
                self._events.count = message.get("events", self._events.count)
