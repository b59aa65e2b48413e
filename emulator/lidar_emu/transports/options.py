"""The port options of the command line, the same for every command that opens a port."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import click

from lidar_emu.transports.spec import (
    DEFAULT_BAUD,
    DEFAULT_BITRATE,
    DEFAULT_DATA_BITRATE,
    parse_port,
)

Command = Callable[..., Any]

_OPTIONS = (
    click.option(
        "--port",
        metavar="PORT",
        help="Serial device, pyserial URL, pty, pty:LINK, udp:[HOST:]PORT, tcp:[HOST:]PORT, or unix:PATH.",
    ),
    click.option(
        "--baud", type=int, metavar="N", help=f"Serial bit rate in bit/s.  [default: {DEFAULT_BAUD}]"
    ),
    click.option(
        "--rs485", is_flag=True, help="Let the serial driver enable the RS-485 transmitter while it sends."
    ),
    click.option("-i", "--interface", metavar="NAME", help="python-can interface name, e.g. socketcan."),
    click.option("-c", "--channel", metavar="NAME", help="CAN channel, e.g. vcan0."),
    click.option(
        "--bitrate", type=int, metavar="N", help=f"CAN bit rate in bit/s.  [default: {DEFAULT_BITRATE}]"
    ),
    click.option("--fd", is_flag=True, help="CAN FD frames."),
    click.option(
        "--data-bitrate",
        type=int,
        metavar="N",
        help=f"CAN FD bit rate of the data phase in bit/s.  [default: {DEFAULT_DATA_BITRATE}]",
    ),
)


def port_options(command: Command) -> Command:
    """Give a click command the port options; it receives one `PortSpec` as the keyword argument `port`.

    Raises (when the command is called):
        InputError: see `parse_port`.
    """

    @wraps(command)
    def with_port(
        *args: Any,
        port: str | None,
        baud: int | None,
        rs485: bool,
        interface: str | None,
        channel: str | None,
        bitrate: int | None,
        fd: bool,
        data_bitrate: int | None,
        **others: Any,
    ) -> Any:
        spec = parse_port(port, baud, interface, channel, bitrate, fd, data_bitrate, rs485)
        return command(*args, port=spec, **others)

    for option in reversed(_OPTIONS):
        with_port = option(with_port)
    return with_port
