"""Messages at the host's end: received ones, also as text and JSON lines, and commands with their acknowledgements."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from lidar_emu.cli.terminal import print_line
from lidar_emu.runtime.clock import Clock
from lidar_emu.transports.messages import Decoder, command_payload
from lidar_emu.transports.opening import ByteHost, CanHost
from lidar_emu.wire import rows
from lidar_protocol import (
    Acknowledge,
    Host,
    Housekeeping,
    Interface,
    Message,
    default_interface,
)
from lidar_protocol.commands import Argument
from lidar_protocol.fields import Counter as FieldCounter
from lidar_protocol.fields import Field, Flag, Value


def device_time_s(message: Acknowledge | Housekeeping) -> float | None:
    """Time of a message by the device's clock, in seconds; None if the interface has no such field."""
    time_ns, time_s = message.values.get("time_ns"), message.values.get("time_s")
    return time_s if time_ns is None else time_ns * 1e-9


def json_lines(message: Message) -> Iterable[str]:
    """One JSON object per beam."""
    return (json.dumps(row) for row in rows(message))


def text_line(message: Message, interface: Interface) -> str:
    """One line per shot: time, unit, shot, then each beam's range and closing speed, or the reason if invalid.

    Four beams fit 80 columns.
    """
    cells = [_cell(row, interface) for row in rows(message)]
    time_s = "-" if message.time_ns is None else f"{message.time_ns * 1e-9:.3f}"
    number = message.sequence if message.shot is None else message.shot
    shot = "-" if number is None else str(number)
    return f"{time_s:>7} {message.unit:>2} {shot:>5}" + "".join(cells)


def heading(beams: int) -> str:
    """The two lines above `text_line`: names and units."""
    names = "".join(f"{f'beam {beam}':>13}   " for beam in range(beams))
    return f"   time unit shot{names}".rstrip() + f"\n{'s':>7}{'':9}" + f"{'m':>8}{'m/s':>8}" * beams


def _cell(row: dict[str, Any], interface: Interface) -> str:
    sent = [row[name] for name in ("range_m", "closing_speed_mps") if name in row]
    if not row.get("range_valid", True) or not sent or None in sent:
        return f" {reason(row, interface):>15}"
    range_text = f"{row['range_m']:.2f}" if "range_m" in row else ""
    speed_text = f"{row['closing_speed_mps']:+.2f}" if "closing_speed_mps" in row else ""
    return f" {range_text:>7} {speed_text:>7}"


def reason(row: dict[str, Any], interface: Interface) -> str:
    """The reason why a beam is invalid, as text."""
    code = row.get("reason")
    if code is None:
        return "invalid" if row.get("fired", True) else "not fired"
    return (interface.word("reason", code) or str(code)).replace("_", " ")


def counter_line(counters: dict[str, int]) -> str:
    """The counters that are not zero."""
    counts = (f"{name.replace('_', ' ')} {value}" for name, value in counters.items() if value)
    return ", ".join(counts) or "nothing"


class ShotPrinter:
    """Prints shots as lines: at most one per unit in `every_s` seconds of the unit's time; 0: all."""

    def __init__(self, every_s: float, interface: Interface | None = None) -> None:
        self._every_s = every_s
        self._interface = interface or default_interface()
        self._shown_s: dict[int, float] = {}

    def show(self, messages: Iterable[Message]) -> None:
        """Print the messages that are due."""
        for message in messages:
            if not self._shown_s:
                print_line(heading(len(message.beams)))
            time_s = (message.time_ns or 0) * 1e-9
            since_s = time_s - self._shown_s.get(message.unit, float("-inf"))
            # If time goes back, the device has restarted.
            if since_s >= self._every_s or since_s < 0:
                print_line(text_line(message, self._interface))
                self._shown_s[message.unit] = time_s


class DeviceLines:
    """Lines for the acknowledgements of one link, and for the changes in its housekeeping.

    Enumerations, flags and counters are printed when they change; values that change by themselves (times,
    temperature) are printed once.
    """

    def __init__(self, interface: Interface) -> None:
        layouts = [interface.housekeeping, interface.acknowledge]
        layouts += [block.layout for block in interface.can.blocks] if interface.can else []
        placed = [each for layout in layouts if layout is not None for each in layout.placed]
        self._interface = interface
        self._fields: dict[str, Field] = {each.field.name: each.field for each in placed}
        self._last: dict[int, dict[str, Value]] = {}

    def json_line(self, message: Acknowledge | Housekeeping) -> str:
        """One JSON object: the unit, and under `acknowledge` or `housekeeping` the fields, with words for numbers."""
        kind = "acknowledge" if isinstance(message, Acknowledge) else "housekeeping"
        words = {name: self._word(name, value) for name, value in message.values.items()}
        return json.dumps({"unit": message.unit, kind: words})

    def text_line(self, message: Acknowledge | Housekeeping) -> str | None:
        """A line; None for housekeeping without changes."""
        if isinstance(message, Acknowledge):
            number = "" if message.sequence is None else f" {message.sequence}"
            verdict = message.verdict.replace("_", " ")
            return f"{_begin(message)} command {message.command or 'unknown'}{number}: {verdict}"
        last = self._last.setdefault(message.unit, {})
        changed = [
            f"{name}={self._text(name, value)}"
            for name, value in message.values.items()
            if self._has_changed(name, value, last)
        ]
        last.update(message.values)
        return " ".join([_begin(message), *changed]) if changed else None

    def _has_changed(self, name: str, value: Value, last: Mapping[str, Value]) -> bool:
        if name not in last:
            return not name.startswith("time_")  # the line begins with it
        field = self._fields[name]
        return value != last[name] and bool(field.enumeration or isinstance(field.codec, FieldCounter | Flag))

    def _text(self, name: str, value: Value) -> str:
        if value is None:
            return "none"
        if isinstance(self._fields[name].codec, Flag):
            return "yes" if value else "no"
        return str(self._word(name, value))

    def _word(self, name: str, value: Value) -> Any:
        enumeration = self._fields[name].enumeration
        if enumeration is None or value is None:
            return value
        return self._interface.word(enumeration, int(value)) or value


def _begin(message: Acknowledge | Housekeeping) -> str:
    time_s = device_time_s(message)
    return f"{'-' if time_s is None else f'{time_s:.3f}':>7} s  unit {message.unit}"


_READ_S = 0.05
_REPEAT_S = 0.5
NO_ACKNOWLEDGEMENT = "no acknowledgement"
SENT = "sent"


class CommandResult(NamedTuple):
    """The result of a command."""

    verdict: str
    """Verdict of the device, or `NO_ACKNOWLEDGEMENT`; `SENT` where the interface has no acknowledgements."""
    time_s: float | None = None
    """Time of the acknowledgement, by the device's clock."""


class CommandClient:
    """Commands one unit over an open link.

    Args:
        timeout_s: longest wait for an acknowledgement.
    """

    def __init__(self, host: ByteHost | CanHost, interface: Interface, unit: int, timeout_s: float) -> None:
        self._host, self._unit, self._timeout_s = host, unit, timeout_s
        self._encoder = Host(interface, unit)
        self._decoder = Decoder(interface)
        self._is_can = isinstance(host, CanHost)
        self._clock = Clock()
        can_acknowledge = interface.can.acknowledge if interface.can else None
        self._has_acknowledgements = bool(can_acknowledge if self._is_can else interface.acknowledge)
        assert interface.commands is not None
        self._steps = interface.commands.sequence_steps
        self._has_no_op = "no_op" in interface.commands.by_name
        self.next_sequence = 0
        """Sequence number of the next command."""

    def synchronise(self) -> CommandResult | None:
        """Synchronise the sequence number with the device; None if the interface has no `no_op`.

        The device accepts a `no_op` with any number but the last command's: whether it is accepted or,
        having that number, rejected, the next number is the one after it. It is repeated, because a device that boots
        receives nothing.
        """
        if not self._has_no_op:
            return None
        self.next_sequence = 1
        ends_ns = self._clock.now_ns() + round(self._timeout_s * 1e9)
        result = CommandResult(NO_ACKNOWLEDGEMENT)
        while result.verdict == NO_ACKNOWLEDGEMENT and self._clock.now_ns() < ends_ns:
            result = self._exchange("no_op", {"sequence": 0}, min(_REPEAT_S, self._timeout_s))
        return result

    def send(self, name: str, values: Mapping[str, Argument]) -> CommandResult:
        """Send a command and wait for its acknowledgement.

        Raises:
            EncodeError: unknown command, or an argument is missing, unknown or cannot be encoded.
        """
        sequence = self.next_sequence
        self.next_sequence = (sequence + 1) % self._steps
        return self._exchange(name, {**values, "sequence": sequence}, self._timeout_s)

    def _exchange(self, name: str, values: Mapping[str, Argument], timeout_s: float) -> CommandResult:
        payload = command_payload(self._encoder, self._is_can, name, values)
        ends_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        is_out = self._host.write(payload)
        while self._clock.now_ns() < ends_ns:
            if is_out and not self._has_acknowledgements:
                return CommandResult(SENT)
            for message in self._decoder.receive(self._host.read(_READ_S)):
                # Some interfaces omit command or sequence.
                if (
                    isinstance(message, Acknowledge)
                    and message.unit == self._unit
                    and message.sequence in (values["sequence"], None)
                    and message.command in (name, None)
                ):
                    return CommandResult(message.verdict, device_time_s(message))
            is_out = is_out or self._host.write(payload)
        return CommandResult(NO_ACKNOWLEDGEMENT)
