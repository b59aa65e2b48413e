"""Commands: encoded by a host, decoded by a device.

A command consists of its code, a sequence number and its arguments. On CAN the identifier replaces the code.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches

from lidar_protocol import can_frames, packet
from lidar_protocol.can_frames import CanFrame
from lidar_protocol.definitions import CommandDefinition, Commands, Interface
from lidar_protocol.errors import DecodeError, EncodeError, Fault
from lidar_protocol.fields import Value
from lidar_protocol.framing import LinkCounters
from lidar_protocol.layout import Layout
from lidar_protocol.packet import BadCommand, Command

Argument = Value | str
"""A value, or a name of the field's enumeration."""

_NO_NUMBER = "it ends before its sequence number, or has none"


def encode(interface: Interface, unit: int, name: str, values: Mapping[str, Argument]) -> bytes:
    """Encode a command as framed bytes. `values` holds `sequence` and the command's arguments.

    Raises:
        EncodeError: the interface has no such command, or an argument is missing, unknown or cannot be sent.
    """
    packet.check_unit(interface, unit)
    command = _command(interface, name)
    body = command.packet.pack(
        _checked(interface, command, command.packet, values), {"command": command.code}
    )
    sequence = values["sequence"]
    assert isinstance(sequence, int)
    return interface.link.framing.encode(packet.seal(interface.link, "command", unit, sequence, body))


def encode_frame(interface: Interface, unit: int, name: str, values: Mapping[str, Argument]) -> CanFrame:
    """Encode a command as a CAN frame.

    Raises:
        EncodeError: as `encode`, or the interface has no commands on CAN.
    """
    packet.check_unit(interface, unit)
    can, command = can_frames.definition(interface), _command(interface, name)
    if command.can is None or command.can_id is None:
        raise EncodeError(f"the interface {interface.name} has no commands on CAN")
    checked = _checked(interface, command, command.can, values)
    can_id = can.id_base + unit * can.unit_stride + command.can_id
    return CanFrame(can_id, command.can.pack(checked))


def _commands(interface: Interface) -> Commands:
    if interface.commands is None:
        raise EncodeError(f"the interface {interface.name} has no commands")
    return interface.commands


def _command(interface: Interface, name: str) -> CommandDefinition:
    commands = _commands(interface).by_name
    if name not in commands:
        hint = "".join(f"did you mean {near}? " for near in get_close_matches(name, commands, 1))
        raise EncodeError(f"command {name}: {hint}the interface has {', '.join(commands)}")
    return commands[name]


def _checked(
    interface: Interface, command: CommandDefinition, layout: Layout, values: Mapping[str, Argument]
) -> dict[str, Value]:
    known = ("sequence", *command.arguments)
    if strange := values.keys() - set(known):
        raise EncodeError(f"{command.name} has no {', '.join(sorted(strange))}; it has {', '.join(known)}")
    numbers = as_numbers(interface, layout, values)
    back = layout.unpack(layout.pack(numbers, {"command": command.code}))
    for name in known:
        problem, sent = _out_of_range(interface, layout, back, name), numbers[name]
        # Rounding a whole number would change the command.
        if (
            problem is None
            and isinstance(sent, float)
            and not sent.is_integer()
            and isinstance(back[name], int)
        ):
            problem = f"{name} has to be a whole number instead"
        if problem is not None:
            raise EncodeError(f"{problem} of {values[name]!r}")
    return numbers


def as_numbers(interface: Interface, layout: Layout, values: Mapping[str, Argument]) -> dict[str, Value]:
    """Replace names of enumerations by their numbers.

    Raises:
        EncodeError: the enumeration does not have the name.
    """
    words = {placed.field.name: placed.field.enumeration for placed in layout.placed}
    numbers: dict[str, Value] = {}
    for name, value in values.items():
        if isinstance(value, str) and name in words:
            known = interface.enumerations.get(words[name] or "", {})
            if value not in known:
                raise EncodeError(f"{name}: {value!r} is none of {', '.join(known) or 'its values'}")
            numbers[name] = known[value]
        elif not isinstance(value, str):
            numbers[name] = value
    return numbers


def _out_of_range(interface: Interface, layout: Layout, values: Mapping[str, Value], name: str) -> str | None:
    (field,) = (placed.field for placed in layout.placed if placed.field.name == name)
    value = values[field.key]
    if value is None:
        return f"{name} is out of range"
    if field.enumeration and interface.word(field.enumeration, int(value)) is None:
        return f"{name} has no such value"
    return None


@dataclass(slots=True)
class CommandCounters(LinkCounters):
    """Counters of received commands: `messages` counts accepted and rejected ones; CAN frames add no skipped
    bytes."""

    rejected: int = 0
    """Undamaged packets to this unit that are not a valid command."""


class CommandReader:
    """Decoder of commands on a byte link, from a stream in portions of any size. It raises no exception."""

    def __init__(self, interface: Interface, unit: int = 0) -> None:
        self.counters = CommandCounters()
        self._interface, self._unit = interface, unit
        longest = interface.maximum_command_bytes
        self._frames = interface.link.framing.reader(longest, self._read, self.counters)

    @property
    def buffered_bytes(self) -> int:
        """Number of bytes that may belong to an incomplete command."""
        return self._frames.buffered_bytes

    def feed(self, data: bytes) -> list[Command | BadCommand]:
        """Decode received bytes; returns the commands that they complete."""
        return self._frames.receive(data)

    def _read(self, frame: bytes) -> Command | BadCommand:
        (kind, unit, _), body = packet.unseal(self._interface.link, frame)
        if kind != "command" or unit != self._unit:
            raise DecodeError(Fault.FOREIGN, "not a command to this unit")
        command = self._command(body)
        self.counters.rejected += isinstance(command, BadCommand)
        return command

    def _command(self, body: bytes) -> Command | BadCommand:
        commands = _commands(self._interface)
        code, sequence = (
            _whole(commands.header.unpack_field(name, body)) for name in ("command", "sequence")
        )
        command = commands.by_code.get(-1 if code is None else code)
        if command is None and sequence is not None:
            return BadCommand(self._unit, code, sequence, "unknown", f"no command has the code {code}")
        if command is None or sequence is None:
            return BadCommand(self._unit, code, sequence, "malformed", _NO_NUMBER)
        return _read_command(self._interface, self._unit, command, command.packet, body)


class CanCommandReader:
    """Decoder of commands on CAN."""

    def __init__(self, interface: Interface, unit: int = 0) -> None:
        self.counters = CommandCounters()
        self._interface, self._unit = interface, unit
        self._commands = can_frames.command_addresses(interface, unit)

    def feed(self, can_id: int, data: bytes, is_fd: bool = False) -> list[Command | BadCommand]:
        """Decode the command in a frame; frames with other identifiers are counted as foreign."""
        command = None if is_fd else self._commands.get(can_id)
        self.counters.frames += 1
        if command is None or command.can is None:
            self.counters.foreign += 1
            return []
        self.counters.messages += 1
        read = _read_command(self._interface, self._unit, command, command.can, data)
        self.counters.rejected += isinstance(read, BadCommand)
        return [read]


def _read_command(
    interface: Interface, unit: int, command: CommandDefinition, layout: Layout, data: bytes
) -> Command | BadCommand:
    sequence = _whole(layout.unpack_field("sequence", data))
    if sequence is None:
        return BadCommand(unit, command.code, None, "malformed", _NO_NUMBER)
    if len(data) != layout.length:
        text = f"{command.name} has {layout.length} bytes, not {len(data)}"
        return BadCommand(unit, command.code, sequence, "malformed", text)
    values = layout.unpack(data)
    for name in command.arguments:
        problem = _out_of_range(interface, layout, values, name)
        if problem is not None:
            return BadCommand(unit, command.code, sequence, "out_of_range", f"{command.name}: {problem}")
    return Command(unit, command.name, sequence, {name: values[name] for name in command.arguments})


def _whole(value: Value) -> int | None:
    return None if value is None else int(value)
