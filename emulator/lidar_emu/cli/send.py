"""`lidar-emu send`: the host's commands."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.options import as_number, require_port, wire_interface_option
from lidar_emu.cli.output import say
from lidar_emu.errors import InputError
from lidar_emu.transports.options import port_options

if TYPE_CHECKING:
    from lidar_emu.cli.commander import Reply
    from lidar_emu.transports.spec import PortSpec
    from lidar_protocol import Interface
    from lidar_protocol.commands import Argument
    from lidar_protocol.definitions import Commands

_Order = tuple[str, dict[str, "Argument"]]


@click.command(short_help="Command the device at the other end of the line.")
@port_options
@click.option("--unit", type=click.IntRange(min=0), metavar="N", default=0, help="Of several on one bus.")
@wire_interface_option
@click.option("--timeout", metavar="S", default="2", show_default=True, help="How long an answer may take.")
@click.option(
    "--sequence", type=int, metavar="N", help="Number of the first command; else a no_op agrees on one."
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object per command and line.")
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
    """Send commands one after another, each once the one before it is accepted.

    Exit code 0 if all were accepted, 1 if one was rejected or not answered. A serial line has one host: what
    `lidar-emu listen` has open, `send` cannot.

    \b
    lidar-emu send --port /dev/ttyUSB1 --baud 921600 set_mode mode=track
    lidar-emu send --port /dev/pts/5 set_pattern pattern=1 set_rate_hz rate_hz=10
    lidar-emu send -i socketcan -c vcan0 enable_beams beams=0b1011
    lidar-emu send --port /dev/pts/5 reset restart=cold
    """
    from lidar_emu.cli.commander import SENT, Commander
    from lidar_emu.transports.host import open_host
    from lidar_emu.transports.spec import Kind
    from lidar_emu.wire import interface_named
    from lidar_protocol import EncodeError

    timeout_s = as_number("--timeout", timeout)
    interface = interface_named(wire_interface, "--wire-interface")
    require_port(port, "send")
    orders = _orders(words, _commands(interface, wire_interface, port.kind is Kind.CAN))
    _check(interface, unit, sequence or 0, orders)
    host = open_host(port)
    try:
        commander = Commander(host, interface, unit, timeout_s)
        if sequence is not None:
            commander.begin_at(sequence)
        elif (greeting := commander.begin_anew()) is not None and not _is_answer(greeting):
            _tell("no_op", {}, greeting, as_json)
            return 1
        for name, values in orders:
            reply = commander.ask(name, values)
            _tell(name, values, reply, as_json)
            if reply.verdict not in ("accepted", SENT):
                return 1
    except EncodeError as error:
        raise InputError("send", None, " ".join(words), str(error)) from None
    finally:
        host.close()
    return 0


def _is_answer(greeting: Reply) -> bool:
    from lidar_emu.cli.commander import UNANSWERED

    return greeting.verdict != UNANSWERED


def _tell(name: str, values: dict[str, Argument], reply: Reply, as_json: bool) -> None:
    if as_json:
        say(json.dumps({"command": name, "values": values, "verdict": reply.verdict, "time_s": reply.time_s}))
        return
    at = "" if reply.time_s is None else f" at {reply.time_s:.3f} s"
    say(f"{_said(name, values)}: {reply.verdict.replace('_', ' ')}{at}")


def _said(name: str, values: dict[str, Argument]) -> str:
    return " ".join([name, *(f"{key}={value}" for key, value in values.items())])


def _commands(interface: Interface, where: str, can: bool) -> Commands:
    commands = interface.commands
    if commands is None or (can and any(each.can is None for each in commands.commands)):
        raise InputError("--wire-interface", None, where, "allowed: one with commands on this kind of link")
    return commands


def _orders(words: tuple[str, ...], commands: Commands) -> list[_Order]:
    """Commands with their arguments: a word without `=` begins the next one."""
    orders: list[_Order] = []
    for word in words:
        name, separator, text = word.partition("=")
        if not separator:
            if name not in commands.by_name:
                raise InputError("send", None, name, f"allowed: {', '.join(commands.by_name)}")
            orders.append((name, {}))
        elif not orders:
            raise InputError("send", None, word, "allowed first: a command")
        elif name in orders[-1][1]:
            raise InputError("send", None, word, f"{orders[-1][0]} has {name} already")
        else:
            orders[-1][1][name] = _value(text)
    return orders


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


def _check(interface: Interface, unit: int, sequence: int, orders: list[_Order]) -> None:
    """Find what cannot be sent before anything is."""
    from lidar_protocol import EncodeError, Host

    for name, values in orders:
        try:
            Host(interface, unit).encode_command(name, **{**values, "sequence": sequence})
        except EncodeError as error:
            raise InputError("send", None, _said(name, values), str(error)) from None
