"""The host's side for the eye and for machines: decoded messages as lines."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from lidar_emu.cli.output import say
from lidar_emu.transports.frames import Frame
from lidar_emu.wire import rows
from lidar_protocol import CanReceiver, Message, SerialReceiver, default_interface


class Decoder:
    """Whatever a port delivers, as messages; bad bytes and frames are counted."""

    def __init__(self) -> None:
        interface = default_interface()
        self._serial = SerialReceiver(interface)
        self._can = CanReceiver(interface)
        self.messages = 0

    def decode(self, arrived: bytes | Iterable[Frame]) -> list[Message]:
        """The messages that are complete with what arrived."""
        if isinstance(arrived, bytes):
            messages = self._serial.receive(arrived)
        else:
            messages = [
                message
                for frame in arrived
                for message in self._can.receive(frame.can_id, frame.data, frame.is_fd)
            ]
        self.messages += len(messages)
        return messages

    def counters(self) -> dict[str, int]:
        """All that was counted, good and bad."""
        used = self._can if self._can.counters.frames else self._serial
        return asdict(used.counters)


def json_lines(message: Message) -> Iterable[str]:
    """One JSON object per beam."""
    return (json.dumps(row) for row in rows(message))


def text_line(message: Message) -> str:
    """One line per shot: time, unit, shot, then range and closing speed of each beam, or why there is none."""
    cells = [_cell(row) for row in rows(message)]
    time_s = "-" if message.time_ns is None else f"{message.time_ns * 1e-9:.3f}"
    shot = "-" if message.shot is None else str(message.shot)
    return f"{time_s:>9} s  unit {message.unit} shot {shot:>6}  " + "  ".join(cells)


def heading(beams: int) -> str:
    """The line above `text_line`."""
    return f"{'time':>9}    {'':>18}  " + "  ".join(
        f"{f'beam {beam}: range m, speed m/s':>26}" for beam in range(beams)
    )


def _cell(row: dict[str, Any]) -> str:
    if row.get("range_valid") and row["range_m"] is not None and row["closing_speed_mps"] is not None:
        return f"{row['range_m']:>13.3f} {row['closing_speed_mps']:>+12.4f}"
    return f"{_reason(row):>26}"


def _reason(row: dict[str, Any]) -> str:
    names = {code: name for name, code in default_interface().enumerations["reason"].items()}
    reason = row.get("reason")
    if reason is None:
        return "invalid" if row.get("fired") else "not fired"
    return names.get(reason, str(reason)).replace("_", " ")


def counter_line(counters: dict[str, int]) -> str:
    """The counters that are not zero."""
    return (
        ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in counters.items() if value)
        or "nothing"
    )


class Screen:
    """Messages as lines; of each unit at most one per `every_s` of its own time, 0 for all."""

    def __init__(self, every_s: float) -> None:
        self._every_s = every_s
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
                say(text_line(message))
                self._shown_s[message.unit] = time_s
