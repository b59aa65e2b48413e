"""What a device says besides measurements, as lines: acknowledgements, and housekeeping where it has news."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from lidar_emu.cli.far_end import told_at_s
from lidar_protocol import Acknowledge, Housekeeping, Interface
from lidar_protocol.fields import Counter, Field, Flag, Value


class DeviceLines:
    """The lines of one link.

    Modes and other words, flags and counters are news when they change; of what changes by itself (times, temperature)
    a line tells when it comes for the first time.
    """

    def __init__(self, interface: Interface) -> None:
        layouts = [interface.housekeeping, interface.acknowledge]
        layouts += [block.layout for block in interface.can.blocks] if interface.can else []
        placed = [each for layout in layouts if layout is not None for each in layout.placed]
        self._interface = interface
        self._fields: dict[str, Field] = {each.field.name: each.field for each in placed}
        self._told: dict[int, dict[str, Value]] = {}

    def json_line(self, message: Acknowledge | Housekeeping) -> str:
        """One JSON object: the unit, and under `acknowledge` or `housekeeping` the fields, with words for numbers."""
        kind = "acknowledge" if isinstance(message, Acknowledge) else "housekeeping"
        return json.dumps({"unit": message.unit, kind: self._with_words(message.values)})

    def text_line(self, message: Acknowledge | Housekeeping) -> str | None:
        """A line; None for housekeeping that has no news."""
        if isinstance(message, Acknowledge):
            number = "" if message.sequence is None else f" {message.sequence}"
            verdict = message.verdict.replace("_", " ")
            return f"{_begin(message)} command {message.command or 'unknown'}{number}: {verdict}"
        told = self._told.setdefault(message.unit, {})
        news = {name: value for name, value in message.values.items() if self._is_news(name, value, told)}
        told.update(message.values)
        if not news:
            return None
        return f"{_begin(message)} " + " ".join(
            f"{name}={self._text(name, value)}" for name, value in news.items()
        )

    def _is_news(self, name: str, value: Value, told: Mapping[str, Value]) -> bool:
        if name not in told:
            return not name.startswith("time_")  # with which the line begins
        field = self._fields[name]
        return value != told[name] and bool(field.enumeration or isinstance(field.codec, Counter | Flag))

    def _text(self, name: str, value: Value) -> str:
        if value is None:
            return "none"
        if isinstance(self._fields[name].codec, Flag):
            return "yes" if value else "no"
        return str(self._word(name, value))

    def _with_words(self, values: Mapping[str, Value]) -> dict[str, Any]:
        return {name: self._word(name, value) for name, value in values.items()}

    def _word(self, name: str, value: Value) -> Any:
        """The word of an enumeration; of anything else the value."""
        enumeration = self._fields[name].enumeration
        if enumeration is None or value is None:
            return value
        return self._interface.word(enumeration, int(value)) or value


def _begin(message: Acknowledge | Housekeeping) -> str:
    time_s = told_at_s(message)
    return f"{'-' if time_s is None else f'{time_s:.3f}':>9} s  unit {message.unit}"
