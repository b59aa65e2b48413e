"""`lidar-emu send`: telecommands to the device."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import click

from lidar_emu.cli.messages import Decoder, device_time_s
from lidar_emu.cli.options import as_number, require_port, wire_interface_option
from lidar_emu.cli.terminal import print_line
from lidar_emu.errors import InputError
from lidar_emu.runtime.clock import Clock
from lidar_emu.transports.can_frames import Frame, pack_frames
from lidar_emu.transports.opening import ByteHost, CanHost
from lidar_emu.transports.spec import port_options
from lidar_protocol import Acknowledge, Host, Interface
from lidar_protocol.commands import Argument

if TYPE_CHECKING:
    from lidar_emu.transports.spec import PortSpec
    from lidar_protocol.definitions import Commands


_Command = tuple[str, dict[str, "Argument"]]


@click.command(short_help="Send commands to the device at the other end of the link.")
@port_options
@click.option(
    "--unit",
    type=click.IntRange(min=0),
    metavar="N",
    default=0,
    help="Unit to command, of several on one bus.",
)
@wire_interface_option
@click.option(
    "--timeout", metavar="S", default="2", show_default=True, help="Longest wait for an acknowledgement."
)
@click.option(
    "--sequence",
    type=int,
    metavar="N",
    help="Sequence number of the first command.  [default: found by a no_op]",
)
@click.option("--json", "as_json", is_flag=True, help="Print a line of JSON per command.")
@click.argument("words", metavar="COMMAND [ARGUMENT=VALUE]...", nargs=-1, required=True)
def send(
    port: PortSpec,
    unit: int,
    wire_interface: str,
    timeout: str,
    sequence: int | None,
    as_json: bool,
    words: tuple[str, ...],
) -> int:
    """Send commands in order, each once the previous one was accepted.

    Exit code 0 if all were accepted, 1 if one was rejected or not acknowledged. A serial line has one host: `send`
    cannot open a port that `lidar-emu listen` has open.

    \b
    lidar-emu send --port /dev/ttyUSB1 --baud 921600 set_mode mode=track
    lidar-emu send --port lidar set_pattern pattern=1 set_rate_hz rate_hz=10
    lidar-emu send -i socketcan -c vcan0 enable_beams beams=0b1011
    lidar-emu send --port lidar --timeout 30 no_op      # once the device has booted
    """
    from lidar_emu.transports.opening import open_host
    from lidar_emu.transports.spec import Kind
    from lidar_emu.wire import interface_named
    from lidar_protocol import EncodeError

    timeout_s = as_number("--timeout", timeout)
    interface = interface_named(wire_interface, "--wire-interface")
    require_port(port, "send")
    commands = _parse(words, _definitions(interface, wire_interface, port.kind is Kind.CAN))
    _check(interface, unit, sequence or 0, commands)
    host = open_host(port)
    try:
        client = CommandClient(host, interface, unit, timeout_s)
        if sequence is not None:
            client.set_sequence(sequence)
        elif (first := client.synchronise()) is not None and first.verdict == NO_ACKNOWLEDGEMENT:
            _print("no_op", {}, first, as_json)
            return 1
        for name, values in commands:
            result = client.send(name, values)
            _print(name, values, result, as_json)
            if result.verdict not in ("accepted", SENT):
                return 1
    except EncodeError as error:
        raise InputError("send", None, " ".join(words), str(error)) from None
    finally:
        host.close()
    return 0


def _print(name: str, values: dict[str, Argument], result: CommandResult, as_json: bool) -> None:
    if as_json:
        print_line(
            json.dumps(
                {"command": name, "values": values, "verdict": result.verdict, "time_s": result.time_s}
            )
        )
        return
    at = "" if result.time_s is None else f" at {result.time_s:.3f} s"
    print_line(f"{_text(name, values)}: {result.verdict.replace('_', ' ')}{at}")


def _text(name: str, values: dict[str, Argument]) -> str:
    return " ".join([name, *(f"{key}={value}" for key, value in values.items())])


def _definitions(interface: Interface, where: str, can: bool) -> Commands:
    commands = interface.commands
    if commands is None or (can and any(each.can is None for each in commands.commands)):
        raise InputError("--wire-interface", None, where, "must be one with commands on this kind of link")
    return commands


def _parse(words: tuple[str, ...], known: Commands) -> list[_Command]:
    """Commands with their arguments: a word without `=` begins the next command."""
    commands: list[_Command] = []
    for word in words:
        name, separator, text = word.partition("=")
        if not separator:
            if name not in known.by_name:
                raise InputError("send", None, name, f"must be {', '.join(known.by_name)}")
            commands.append((name, {}))
        elif not commands:
            raise InputError("send", None, word, "allowed first: a command")
        elif name in commands[-1][1]:
            raise InputError("send", None, word, f"{commands[-1][0]} has {name} already")
        else:
            commands[-1][1][name] = _value(text)
    return commands


def _value(text: str) -> Argument:
    """A number in any of Python's notations, or a word."""
    try:
        return int(text, 0)
    except ValueError:
        pass
    try:
        return float(text)
    except ValueError:
        return text


def _check(interface: Interface, unit: int, sequence: int, commands: list[_Command]) -> None:
    """Encode all commands before the first one is sent, to reject errors early."""
    from lidar_protocol import EncodeError, Host

    for name, values in commands:
        try:
            Host(interface, unit).encode_command(name, **{**values, "sequence": sequence})
        except EncodeError as error:
            raise InputError("send", None, _text(name, values), str(error)) from None


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
        host: the link.
        interface: message definitions.
        unit: number of the commanded device.
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
        self._next = 0

    def set_sequence(self, sequence: int) -> None:
        """Set the sequence number of the next command."""
        self._next = sequence

    def synchronise(self) -> CommandResult | None:
        """Synchronise the sequence number with the device; None if the interface has no `no_op`.

        The device accepts a `no_op` with any number but the last command's: whether it is accepted or,
        having that number, rejected, the next number is the one after it. It is repeated, because a device that boots
        receives nothing.
        """
        if not self._has_no_op:
            return None
        self._next = 1
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
        sequence, self._next = self._next, (self._next + 1) % self._steps
        return self._exchange(name, {**values, "sequence": sequence}, self._timeout_s)

    def _exchange(self, name: str, values: Mapping[str, Argument], timeout_s: float) -> CommandResult:
        payload = self._encoded(name, values)
        ends_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        is_out = self._host.write(payload)
        while self._clock.now_ns() < ends_ns:
            if is_out and not self._has_acknowledgements:
                return CommandResult(SENT)
            for message in self._decoder.receive(self._host.read(_READ_S)):
                if isinstance(message, Acknowledge) and self._matches(message, name, values["sequence"]):
                    return CommandResult(message.verdict, device_time_s(message))
            is_out = is_out or self._host.write(payload)
        return CommandResult(NO_ACKNOWLEDGEMENT)

    def _encoded(self, name: str, values: Mapping[str, Argument]) -> bytes:
        if not self._is_can:
            return self._encoder.encode_command(name, **values)
        frame = self._encoder.encode_command_frame(name, **values)
        return pack_frames([Frame(frame.can_id, frame.data)])

    def _matches(self, message: Acknowledge, name: str, sequence: Argument) -> bool:
        """Whether it acknowledges this command; some interfaces omit command or sequence."""
        return (
            message.unit == self._unit
            and message.sequence in (sequence, None)
            and message.command in (name, None)
        )
