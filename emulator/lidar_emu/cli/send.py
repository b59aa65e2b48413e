"""`lidar-emu send` and `lidar-emu inject`: telecommands to the device, and faults into a run."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.options import (
    SectionedCommand,
    as_number,
    port_options,
    require_port,
    wire_interface_option,
)
from lidar_emu.cli.terminal import print_line
from lidar_emu.errors import InputError, RunError, did_you_mean, listed, nearest

if TYPE_CHECKING:
    from lidar_emu.cli.messages import CommandResult
    from lidar_emu.transports.spec import PortSpec
    from lidar_protocol import Interface
    from lidar_protocol.commands import Argument
    from lidar_protocol.definitions import Commands

_Command = tuple[str, dict[str, "Argument"]]


@click.command(cls=SectionedCommand, short_help="Send commands to the device at the other end of the link.")
@port_options
@click.option("--control", metavar="PATH", help="Send them through a run started with --control PATH.")
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
    control: str | None,
    unit: int,
    wire_interface: str,
    timeout: str,
    sequence: int | None,
    as_json: bool,
    words: tuple[str, ...],
) -> int:
    """Send commands in order, each once the previous one was accepted.

    Exit code 0 if all were accepted, 1 if one was rejected or not acknowledged. A serial line has one host: while
    another program has the port open, use --control.

    \b
    lidar-emu send --port /dev/ttyUSB1 --baud 921600 set_mode mode=track
    lidar-emu send --port lidar set_pattern pattern=1 set_rate_hz rate_hz=10
    lidar-emu send -i socketcan -c vcan0 enable_beams beams=0b1011
    lidar-emu send --port lidar --timeout 30 no_op      # once the device has booted
    lidar-emu send --control /tmp/lidar.sock set_pattern pattern=1
    """
    if control is not None:
        given = {
            "--unit": unit or None,
            "--wire-interface": None if wire_interface == "default" else wire_interface,
        }
        _refuse_beside_control(port, {**given, "--sequence": sequence})
        return _send_by_control(control, as_number("--timeout", timeout), _parse(words, None), as_json)
    from lidar_emu.cli.messages import NO_ACKNOWLEDGEMENT, SENT, CommandClient
    from lidar_emu.transports.opening import open_host
    from lidar_emu.transports.spec import Kind
    from lidar_emu.wire import interface_named
    from lidar_protocol import EncodeError

    timeout_s = as_number("--timeout", timeout)
    interface = interface_named(wire_interface, "--wire-interface")
    require_port(port, "send")
    known, is_can = interface.commands, port.kind is Kind.CAN
    if known is None or (is_can and any(each.can is None for each in known.commands)):
        remedy = "must define commands for this kind of link"
        raise InputError("--wire-interface", None, wire_interface, remedy)
    commands = _parse(words, known)
    _check(interface, unit, sequence or 0, commands)
    host = open_host(port.on_line(interface.serial_format))
    try:
        client = CommandClient(host, interface, unit, timeout_s)
        if sequence is not None:
            client.next_sequence = sequence
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
        print_line(json.dumps({"command": name, "values": values, **result._asdict()}))
        return
    at = "" if result.time_s is None else f" at {result.time_s:.3f} s"
    print_line(f"{_text(name, values)}: {result.verdict.replace('_', ' ')}{at}")


def _text(name: str, values: dict[str, Argument]) -> str:
    return " ".join([name, *(f"{key}={value}" for key, value in values.items())])


def _refuse_beside_control(port: PortSpec, options: dict[str, object]) -> None:
    from lidar_emu.transports.spec import Kind

    is_open = port.kind is not Kind.LOOPBACK
    option = "--interface" if port.kind is Kind.CAN else "--port"
    for name, value in {option: str(port) if is_open else None, **options}.items():
        if value is not None:
            raise InputError(name, None, value, "cannot be combined with --control: the run has its own")


def _send_by_control(path: str, timeout_s: float, commands: list[_Command], as_json: bool) -> int:
    from lidar_emu.cli.messages import NO_ACKNOWLEDGEMENT, CommandResult
    from lidar_emu.transports.control_request import request

    reply = request(path, json.dumps({"commands": commands}), "--control", timeout_s)
    if "results" not in reply:
        text = " ".join(_text(name, values) for name, values in commands)
        raise InputError("send", None, text, reply["reason"])
    results = [
        CommandResult(each["verdict"] or NO_ACKNOWLEDGEMENT, each["time_s"]) for each in reply["results"]
    ]
    executed = zip(commands, results, strict=False)  # up to the first that was not accepted
    for (name, values), result in executed:
        _print(name, values, result, as_json)
    return int(any(result.verdict != "accepted" for result in results))


def _parse(words: tuple[str, ...], known: Commands | None) -> list[_Command]:
    """Commands with their arguments: a word without `=` begins the next command.

    Args:
        known: the commands of the interface; None: the run checks them.
    """
    commands: list[_Command] = []
    for word in words:
        name, separator, text = word.partition("=")
        if not separator:
            if known is not None and name not in known.by_name:
                hint = did_you_mean(nearest(name, known.by_name))
                raise InputError("send", None, name, f"{hint}must be one of {listed(known.by_name)}")
            commands.append((name, {}))
        elif not commands:
            raise InputError("send", None, word, "must follow a command")
        elif name in commands[-1][1]:
            raise InputError("send", None, word, f"{commands[-1][0]} has {name} already")
        else:
            commands[-1][1][name] = _value(text)
    return commands


def _value(text: str) -> Argument:
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


@click.command(short_help="Inject a fault into a run started with --control PATH.")
@click.argument("path")
@click.argument("fault", nargs=-1, required=True)
@click.option("--json", "as_json", is_flag=True, help="Print the reply as JSON.")
def inject(path: str, fault: tuple[str, ...], as_json: bool) -> int:
    """Inject FAULT into the run that was started with --control PATH.

    FAULT is a mapping as in a scenario, or keys and values. Its times count from the first shot that it can still
    affect; lasts_s without a probability is its duration.

    \b
    lidar-emu inject /tmp/lidar.sock '{kind: dropout, beams: [2], lasts_s: 2}'
    lidar-emu inject /tmp/lidar.sock kind=bias range_m=3 ramp_s=5
    """
    if all("=" in word and not word.lstrip().startswith("{") for word in fault):
        mapping = "{" + ", ".join(": ".join(word.split("=", 1)) for word in fault) + "}"
    else:
        mapping = " ".join(fault)
    from lidar_emu.transports.control_request import request

    reply = request(path, mapping)
    if as_json:
        print_line(json.dumps(reply))
    elif reply["accepted"]:
        print_line(f"accepted: fault {reply['fault']}, {reply['kind']}")
    else:
        raise RunError(f"rejected: {reply['reason']}")
    return 0 if reply["accepted"] else 1
