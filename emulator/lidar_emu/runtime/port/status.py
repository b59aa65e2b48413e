"""What the port's process has said so far."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

from lidar_emu.errors import InputError
from lidar_emu.runtime.port.events import EventLog, LinkEvent, told
from lidar_emu.transports.link import COUNTED


class Arrival(NamedTuple):
    """What arrived on the port. Instants are those of the monotonic clock."""

    at_ns: int
    data: bytes
    """On CAN, frame records."""
    pulse_ns: int | None
    """When the last pulse before it came; None: there was none, or the port has no pulse line."""


@dataclass
class PortStatus:
    """Kept from its answers."""

    description: str = ""
    """Name of the port; of a pty, the path that the host opens."""
    sent_bytes: int | None = None
    """Known at the end; None if the process died before it could tell."""
    received_bytes: int | None = None
    """What arrived on the port; known when `sent_bytes` is."""
    rx_overrun_bytes: int | None = None
    """Of what arrived, what came too fast to be passed on."""
    unsent: int | None = None
    """Payloads of `send_now` that the link did not take."""
    noticed: dict[str, int | None] = field(default_factory=lambda: dict.fromkeys(COUNTED))
    """What a CAN bus counts besides data; known when `sent_bytes` is."""
    granted: list[str] = field(default_factory=list)
    """What the system gave towards punctuality; see `RealtimePrivileges`."""
    missing: dict[str, str] = field(default_factory=dict)
    """What it refused, each with the command that would give it."""
    finished: bool = False
    arrived: list[Arrival] = field(default_factory=list)
    happened: list[LinkEvent] = field(default_factory=list)
    """Events that nobody has taken yet."""
    start_ns: int = 0
    """The instant from which the times of events count: the beginning of the flight, or as long as there is none the
    opening of the port."""
    _events: EventLog = field(default_factory=EventLog)

    @property
    def events(self) -> list[LinkEvent]:
        """What happened to the link so far: of more than 20 events the first and the last ten."""
        return self._events.since(self.start_ns)

    @property
    def event_count(self) -> int:
        """How many events there were, with those that `events` leaves out."""
        return self._events.count

    def to_json(self, load: float | None) -> dict[str, Any]:
        """What became of port and link, under the names of the summary file.

        Args:
            load: how much of the link the shots take.
        """
        wire = {
            "load": load,
            "sent_bytes": self.sent_bytes,
            "received_bytes": self.received_bytes,
            "rx_overrun_bytes": self.rx_overrun_bytes,
            "tx_dropped": self.unsent,
            **self.noticed,
        }
        return {
            "granted": self.granted,
            "missing": self.missing,
            "wire": wire,
            **told("link", self.event_count, self.events),
        }

    def understand(self, answers: list[dict[str, Any]]) -> None:
        """Take in what it said.

        Raises:
            InputError: it could not open the port.
        """
        for answer in answers:
            match answer:
                case {"refused": refusal}:
                    raise InputError(*refusal)
                case {"ready": description}:
                    self.description = description
                case {"granted": granted, "missing": missing}:
                    self.granted, self.missing = granted, missing
                case {"arrived": [time_ns, data, pulse_ns]}:
                    self.arrived.append(Arrival(time_ns, bytes.fromhex(data), pulse_ns))
                case {"event": [number, time_ns, text]}:
                    self._events.add(number, time_ns, text)
                    self.happened.append(LinkEvent(time_ns - self.start_ns, text))
                case {"finished": counts} | {"stopped": counts}:
                    self.finished = True
                    self.sent_bytes, self.received_bytes = counts["sent_bytes"], counts["received_bytes"]
                    self.rx_overrun_bytes, self.unsent = counts["rx_overrun_bytes"], counts["unsent"]
                    self.noticed = {name: counts[name] for name in COUNTED}
