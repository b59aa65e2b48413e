"""`lidar-emu listen`: the host's end of the link."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.options import (
    SectionedCommand,
    plain_option,
    port_options,
    require_port,
    wire_interface_option,
)
from lidar_emu.cli.terminal import has_terminal, is_silenced, print_line, print_note
from lidar_emu.errors import InputError
from lidar_emu.runtime.signals import on_signals

if TYPE_CHECKING:
    from lidar_emu.transports.messages import Decoder
    from lidar_emu.transports.spec import PortSpec
    from lidar_protocol import Interface, Received

    Show = Callable[[Received], None]

_READ_S = 0.2


@click.command(cls=SectionedCommand, short_help="Decode packets at the host's end of the link.")
@port_options
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print a line of JSON per beam, acknowledgement and housekeeping packet.",
)
@plain_option
@wire_interface_option
@click.option("--count", type=click.IntRange(min=1), metavar="N", help="Stop after N shots.")
def listen(port: PortSpec, as_json: bool, plain: bool, wire_interface: str, count: int | None) -> None:
    """Decode received packets, and count gaps and bad bytes.

    A terminal shows the last shot of each unit, its mode and the counters. Elsewhere, and with --plain, one line is
    printed per shot, per acknowledgement, and per change in housekeeping (mode, flags, counters).

    `--port pty` opens a pseudo-terminal and prints the path for `lidar-emu run --port PATH`. Ctrl-C ends it.

    \b
    lidar-emu listen --port /dev/ttyUSB1 --baud 921600
    lidar-emu listen --port pty --json
    lidar-emu listen -i socketcan -c vcan0 --count 100
    lidar-emu listen --port /dev/ttyUSB1 --wire-interface my.toml
    """
    from lidar_emu.cli.messages import counter_line
    from lidar_emu.transports.messages import Decoder
    from lidar_emu.transports.opening import open_host
    from lidar_emu.transports.spec import Kind
    from lidar_emu.wire import interface_named
    from lidar_protocol import Message

    interface = interface_named(wire_interface, "--wire-interface")
    if port.kind is Kind.CAN and interface.can is None:
        raise InputError("--wire-interface", None, wire_interface, "must define messages on CAN")
    require_port(port, "listen")
    host = open_host(port.on_line(interface.serial_format))
    decoder = Decoder(interface)
    left = count
    with _until_signal() as ended:
        print_note(f"listening on {host.description}")
        try:
            with _view(decoder, as_json, plain) as show:
                # A closed output, as of `lidar-emu listen | head`, ends it: it prints to nobody.
                while left != 0 and not (ended.is_set() or is_silenced()):
                    for message in decoder.receive(host.read(_READ_S)):
                        if left != 0:
                            show(message)
                        if left and isinstance(message, Message):
                            left -= 1
        except KeyboardInterrupt:
            pass
        finally:
            host.close()
            lost = f"; the link broke {host.times_lost} times" if host.times_lost else ""
            print_note(f"received: {counter_line(decoder.counters())}{lost}")


@contextmanager
def _until_signal() -> Iterator[Event]:
    """An event that a signal sets, so that what is received is shown in full; a second signal interrupts."""
    ended = Event()

    def end(*_: object) -> None:
        if ended.is_set():
            raise KeyboardInterrupt
        ended.set()

    with on_signals(end):
        yield ended


@contextmanager
def _view(decoder: Decoder, as_json: bool, plain: bool) -> Iterator[Show]:
    if as_json or plain or not has_terminal():
        yield _printer(decoder.interface, as_json)
        return
    from lidar_emu.cli.dashboard import Dashboard
    from lidar_emu.cli.displays import ListenDisplay

    with Dashboard() as dashboard:
        display = ListenDisplay(dashboard, decoder)
        yield lambda message: display.store([message])


def _printer(interface: Interface, as_json: bool) -> Show:
    from lidar_emu.cli.messages import DeviceLines, ShotPrinter, json_lines
    from lidar_protocol import Message

    shots, device = ShotPrinter(0.0, interface), DeviceLines(interface)

    def show(message: Received) -> None:
        if not isinstance(message, Message):
            line = device.json_line(message) if as_json else device.text_line(message)
            if line is not None:
                print_line(line)
        elif as_json:
            print_line("\n".join(json_lines(message)))
        else:
            shots.show([message])

    return show
