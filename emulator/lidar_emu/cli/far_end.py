"""The host's side for the eye and for machines: decoded messages as lines."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from lidar_emu.cli.output import say
from lidar_emu.transports.frames import Frame
from lidar_emu.wire import rows
from lidar_protocol import (
    Acknowledge,
    CanReceiver,
    Housekeeping,
    Interface,
    Message,
    Received,
    SerialReceiver,
    default_interface,
)


class Decoder:
    """Whatever a port delivers, as messages; bad bytes and frames are counted."""

    def __init__(self, interface: Interface | None = None) -> None:
        self.interface = interface or default_interface()
        self._serial = SerialReceiver(self.interface)
        self._can = CanReceiver(self.interface) if self.interface.can else None
        self._kinds: Counter[type] = Counter()

    def decode(self, arrived: bytes | Iterable[Frame]) -> list[Message]:
        """The measurements that are complete with what arrived."""
        return [message for message in self.receive(arrived) if isinstance(message, Message)]

    def receive(self, arrived: bytes | Iterable[Frame]) -> list[Received]:
        """All that is complete with what arrived."""
        received: list[Received] = []
        if isinstance(arrived, bytes):
            received = self._serial.receive(arrived)
        elif self._can is not None:
            for frame in arrived:
                received += self._can.receive(frame.can_id, frame.data, frame.is_fd)
        self._kinds.update(type(message) for message in received)
        return received

    @property
    def messages(self) -> int:
        """How many measurements came."""
        return self._kinds[Message]

    def counters(self) -> dict[str, int]:
        """All that was counted, good and bad. On CAN each frame of housekeeping counts."""
        is_can = self._can is not None and self._can.counters.frames > 0
        counters = self._can.counters if self._can is not None and is_can else self._serial.counters
        kinds = {"acknowledgements": self._kinds[Acknowledge], "housekeeping": self._kinds[Housekeeping]}
        return {**asdict(counters), **kinds}


def told_at_s(message: Acknowledge | Housekeeping) -> float | None:
    """When it was said, by the device's clock; None where the interface does not say."""
    time_ns, time_s = message.values.get("time_ns"), message.values.get("time_s")
    return time_s if time_ns is None else time_ns * 1e-9


def json_lines(message: Message) -> Iterable[str]:
    """One JSON object per beam."""
    return (json.dumps(row) for row in rows(message))


def text_line(message: Message, interface: Interface) -> str:
    """One line per shot: time, unit, shot, then range and closing speed of each beam, or why there is none."""
    cells = [_cell(row, interface) for row in rows(message)]
    time_s = "-" if message.time_ns is None else f"{message.time_ns * 1e-9:.3f}"
    number = message.sequence if message.shot is None else message.shot
    shot = "-" if number is None else str(number)
    return f"{time_s:>9} s  unit {message.unit} shot {shot:>6}  " + "  ".join(cells)


def heading(beams: int) -> str:
    """The line above `text_line`."""
    return f"{'time':>9}    {'':>18}  " + "  ".join(
        f"{f'beam {beam}: range m, speed m/s':>26}" for beam in range(beams)
    )


def _cell(row: dict[str, Any], interface: Interface) -> str:
    values = [row.get("range_m"), row.get("closing_speed_mps")]
    sent = [name in row for name in ("range_m", "closing_speed_mps")]
    usable = row.get("range_valid", True) and all(
        value is not None for value, is_sent in zip(values, sent, strict=True) if is_sent
    )
    if not usable or not any(sent):
        return f"{reason(row, interface):>26}"
    range_m, speed_mps = values
    return " ".join(
        (
            f"{'' if range_m is None else f'{range_m:.3f}':>13}",
            f"{'' if speed_mps is None else f'{speed_mps:+.4f}':>12}",
        )
    )


def reason(row: dict[str, Any], interface: Interface) -> str:
    """Why a beam is invalid, in words."""
    code = row.get("reason")
    if code is None:
        return "invalid" if row.get("fired", True) else "not fired"
    return (interface.word("reason", code) or str(code)).replace("_", " ")


def counter_line(counters: dict[str, int]) -> str:
    """The counters that are not zero."""
    return (
        ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in counters.items() if value)
        or "nothing"
    )


class Screen:
    """Messages as lines; of each unit at most one per `every_s` of its own time, 0 for all."""

    def __init__(self, every_s: float, interface: Interface | None = None) -> None:
        self._every_s = every_s
        self._interface = interface or default_interface()
        self._shown_s: dict[int, float] = {}

    def show(self, messages: Iterable[Message]) -> None:
        """Print those that are due."""
        for message in messages:
            if not self._shown_s:
                say(heading(len(message.beams)))
            time_s = (message.time_ns or 0) * 1e-9
            since_s = time_s - self._shown_s.get(message.unit, float("-inf"))
            # Time that goes back is a device that started anew.
            if since_s >= self._every_s or since_s < 0:
                say(text_line(message, self._interface))
                self._shown_s[message.unit] = time_s
