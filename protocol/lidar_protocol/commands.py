"""Commands and messages of the host: encoded by a host, decoded by a device.

Each consists of its code, a sequence number and its arguments. On CAN the identifier replaces the code, and a message
is divided into frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches

from lidar_protocol import can_frames, packet
from lidar_protocol.can_frames import CanFrame
from lidar_protocol.definitions import CommandDefinition, Commands, HostMessageDefinition, Interface
from lidar_protocol.errors import DecodeError, EncodeError, Fault
from lidar_protocol.fields import Number, Value
from lidar_protocol.framing import LinkCounters
from lidar_protocol.layout import Layout, PlacedField
from lidar_protocol.packet import BadCommand, Command, HostMessage

Argument = Value | str
"""A value, or a name of the field's enumeration."""
FromHost = Command | HostMessage | BadCommand
"""What a device decodes."""

_NO_NUMBER = "it ends before its sequence number, or has none"


def encode(interface: Interface, unit: int, name: str, values: Mapping[str, Argument]) -> bytes:
    """Encode a command as framed bytes. `values` holds `sequence` and the command's arguments.

    Raises:
        EncodeError: the interface has no such command, or an argument is missing, unknown or cannot be sent.
    """
    return _encode(interface, unit, _command(interface, name), values)


def encode_message(interface: Interface, unit: int, name: str, values: Mapping[str, Argument]) -> bytes:
    """Encode a message of the host as framed bytes. `values` holds `sequence` and all other fields by key.

    Raises:
        EncodeError: the interface has no such message, or a value is missing, unknown or cannot be sent.
    """
    return _encode(interface, unit, _message(interface, name), values)


def _encode(
    interface: Interface, unit: int, command: CommandDefinition, values: Mapping[str, Argument]
) -> bytes:
    packet.check_unit(interface, unit)
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


def encode_message_frames(
    interface: Interface, unit: int, name: str, values: Mapping[str, Argument]
) -> list[CanFrame]:
    """Encode a message of the host as CAN frames, in the order of transmission.

    Raises:
        EncodeError: as `encode_message`, or the message is not sent on CAN.
    """
    packet.check_unit(interface, unit)
    can, message = can_frames.definition(interface), _message(interface, name)
    if not message.can_parts:
        raise EncodeError(f"the interface {interface.name} has no {name} on CAN")
    return [
        CanFrame(
            can.can_id(unit, part),
            part.layout.pack(_checked(interface, message, part.layout, values)),
        )
        for part in message.can_parts
    ]


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


def _message(interface: Interface, name: str) -> HostMessageDefinition:
    messages = _commands(interface).messages_by_name
    if name not in messages:
        raise EncodeError(f"message {name}: the interface has {', '.join(messages) or 'none'}")
    return messages[name]


def _checked(
    interface: Interface, command: CommandDefinition, layout: Layout, values: Mapping[str, Argument]
) -> dict[str, Value]:
    known = ("sequence", *command.arguments)
    if strange := values.keys() - set(known):
        raise EncodeError(f"{command.name} has no {', '.join(sorted(strange))}; it has {', '.join(known)}")
    numbers = as_numbers(interface, layout, values)
    data = layout.pack(numbers, {"command": command.code})
    back = layout.unpack(data)
    for placed in layout.placed:
        name = placed.field.key
        if name not in known:
            continue
        problem, sent = _problem(interface, command, layout, placed, data, back[name]), numbers.get(name)
        if problem is None and back[name] is None and sent is not None and sent == sent:
            problem = f"{name} is out of range"  # the code for none is sent in its place
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
    words = {placed.field.key: placed.field.enumeration for placed in layout.placed}
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


def _problem(
    interface: Interface,
    definition: CommandDefinition,
    layout: Layout,
    placed: PlacedField,
    data: bytes,
    value: Value,
) -> str | None:
    """What is wrong with a decoded value. A message may lack a value where the field has a code for that."""
    field, codec = placed.field, placed.field.codec
    if value is None:
        none = codec.none if isinstance(codec, Number) else None
        may_lack = isinstance(definition, HostMessageDefinition) and none is not None
        if may_lack and layout.bits(placed, data) == (none or 0) % (1 << codec.bits):
            return None
        return f"{field.key} is out of range"
    if field.enumeration and interface.word(field.enumeration, int(value)) is None:
        return f"{field.key} has no such value"
    return None


@dataclass(slots=True)
class CommandCounters(LinkCounters):
    """Counters of received commands and messages: `messages` counts accepted and rejected ones; CAN frames add no
    skipped bytes."""

    rejected: int = 0
    """Undamaged packets to this unit that are not a valid command or message."""
    incomplete: int = 0
    """CAN frames of messages that are dropped: one of the message is missing, or they are out of order."""


class CommandReader:
    """Decoder of commands and messages on a byte link, from a stream in portions of any size. It raises no
    exception."""

    def __init__(self, interface: Interface, unit: int = 0) -> None:
        self.counters = CommandCounters()
        self._interface, self._unit = interface, unit
        longest = interface.maximum_command_bytes
        self._frames = interface.link.framing.reader(longest, self._read, self.counters)

    @property
    def buffered_bytes(self) -> int:
        """Number of bytes that may belong to an incomplete command."""
        return self._frames.buffered_bytes

    def feed(self, data: bytes) -> list[FromHost]:
        """Decode received bytes; returns the commands and messages that they complete."""
        return self._frames.receive(data)

    def _read(self, frame: bytes) -> FromHost:
        (kind, unit, _), body = packet.unseal(self._interface.link, frame)
        if kind != "command" or unit != self._unit:
            raise DecodeError(Fault.FOREIGN, "not a command to this unit")
        command = self._command(body)
        self.counters.rejected += isinstance(command, BadCommand)
        return command

    def _command(self, body: bytes) -> FromHost:
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
    """Decoder of commands and messages on CAN. The frames of a message have to arrive in their order."""

    def __init__(self, interface: Interface, unit: int = 0) -> None:
        self.counters = CommandCounters()
        self._interface, self._unit = interface, unit
        self._commands = can_frames.command_addresses(interface, unit)
        self._parts = can_frames.host_message_addresses(interface, unit)
        self._begun: dict[str, list[bytes]] = {}
        """Frames of messages of which others are missing, by the name of the message."""

    def feed(self, can_id: int, data: bytes, is_fd: bool = False) -> list[FromHost]:
        """Decode the command in a frame, or the message that it completes; frames with other identifiers are counted
        as foreign."""
        command = None if is_fd else self._commands.get(can_id)
        self.counters.frames += 1
        if not is_fd and can_id in self._parts:
            return self._take_part(*self._parts[can_id], data)
        if command is None or command.can is None:
            self.counters.foreign += 1
            return []
        return [self._counted(_read_command(self._interface, self._unit, command, command.can, data))]

    def _counted(self, read: FromHost) -> FromHost:
        self.counters.messages += 1
        self.counters.rejected += isinstance(read, BadCommand)
        return read

    def _take_part(self, message: HostMessageDefinition, place: int, data: bytes) -> list[FromHost]:
        layouts, begun = [part.layout for part in message.can_parts], self._begun.pop(message.name, [])
        if not place:
            self.counters.incomplete += len(begun)
            begun = []
        is_next = place == len(begun) and len(data) == layouts[place].length
        begun.append(data)
        numbers = {
            layout.unpack_field("sequence", each) for layout, each in zip(layouts, begun, strict=False)
        }
        if not is_next or len(numbers) > 1:
            self.counters.incomplete += len(begun)
            return []
        if len(begun) < len(layouts):
            self._begun[message.name] = begun
            return []
        values: dict[str, Value] = {}
        for layout, each in zip(layouts, begun, strict=True):
            read = _read_command(self._interface, self._unit, message, layout, each)
            if not isinstance(read, HostMessage):
                return [self._counted(read)]
            values |= read.values
        sequence = _whole(numbers.pop()) or 0
        return [self._counted(HostMessage(self._unit, message.name, sequence, values))]


def _read_command(
    interface: Interface, unit: int, command: CommandDefinition, layout: Layout, data: bytes
) -> FromHost:
    sequence = _whole(layout.unpack_field("sequence", data))
    if sequence is None:
        return BadCommand(unit, command.code, None, "malformed", _NO_NUMBER)
    if len(data) != layout.length:
        text = f"{command.name} has {layout.length} bytes, not {len(data)}"
        return BadCommand(unit, command.code, sequence, "malformed", text)
    values = layout.unpack(data)
    given: dict[str, Value] = {}
    for placed in layout.placed:
        name = placed.field.key
        if name not in command.arguments:
            continue
        problem = _problem(interface, command, layout, placed, data, values[name])
        if problem is not None:
            return BadCommand(unit, command.code, sequence, "out_of_range", f"{command.name}: {problem}")
        given[name] = values[name]
    kind = HostMessage if isinstance(command, HostMessageDefinition) else Command
    return kind(unit, command.name, sequence, given)


def _whole(value: Value) -> int | None:
    return None if value is None else int(value)
