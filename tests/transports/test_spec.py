"""Which options name which port."""

from __future__ import annotations

import json
from typing import Any

import click
import pytest

from lidar_emu.cli.options import port_options
from lidar_emu.errors import InputError
from lidar_emu.transports.spec import Kind, PortSpec, parse_port

PORTS: list[tuple[dict[str, Any], PortSpec]] = [
    ({}, PortSpec(Kind.LOOPBACK)),
    ({"port": "/dev/ttyUSB0"}, PortSpec(Kind.SERIAL, "/dev/ttyUSB0", baud=115_200)),
    ({"port": "pty", "baud": 921_600}, PortSpec(Kind.PTY, baud=921_600)),
    ({"port": "/dev/ttyS1", "rs485": True}, PortSpec(Kind.SERIAL, "/dev/ttyS1", rs485=True)),
    (
        {"port": "/dev/ttyS1", "serial_format": "8E2"},
        PortSpec(Kind.SERIAL, "/dev/ttyS1", serial_format="8E2"),
    ),
    ({"port": "udp:5600"}, PortSpec(Kind.UDP, "127.0.0.1:5600", baud=0)),
    ({"port": "udp:bench:5600", "baud": 921_600}, PortSpec(Kind.UDP, "bench:5600", baud=921_600)),
    ({"port": "udp:[::1]:5600"}, PortSpec(Kind.UDP, "[::1]:5600", baud=0)),
    ({"port": "tcp:5600"}, PortSpec(Kind.TCP, "127.0.0.1:5600", baud=0)),
    ({"port": "tcp:[::]:5600", "baud": 9600}, PortSpec(Kind.TCP, "[::]:5600", baud=9600)),
    ({"port": "unix:/tmp/lidar"}, PortSpec(Kind.UNIX, "/tmp/lidar", baud=0)),
    ({"port": "pty:/tmp/lidar"}, PortSpec(Kind.PTY, "/tmp/lidar")),
    ({"port": "socket://localhost:7000"}, PortSpec(Kind.SERIAL, "socket://localhost:7000")),
    (
        {"interface": "socketcan", "channel": "vcan0"},
        PortSpec(Kind.CAN, interface="socketcan", channel="vcan0", bitrate=500_000),
    ),
    (
        {
            "interface": "slcan",
            "channel": "/dev/ttyACM0",
            "bitrate": 1_000_000,
            "fd": True,
            "data_bitrate": 5_000_000,
        },
        PortSpec(
            Kind.CAN,
            interface="slcan",
            channel="/dev/ttyACM0",
            bitrate=1_000_000,
            fd=True,
            data_bitrate=5_000_000,
        ),
    ),
]


@pytest.mark.parametrize(("options", "spec"), PORTS)
def test_options_name_a_port(options: dict[str, Any], spec: PortSpec) -> None:
    assert parse_port(**options) == spec
    assert PortSpec.from_json(json.loads(json.dumps(spec.to_json()))) == spec
    show = click.command(port_options(lambda port: port))
    assert show.main(spec.to_options(), standalone_mode=False) == spec


@pytest.mark.parametrize(
    ("options", "option", "allowed"),
    [
        (
            {"port": "pty", "interface": "slcan", "channel": "x"},
            "--port",
            "cannot be combined with --interface slcan",
        ),
        ({"port": "", "baud": 9600}, "--port", "a device"),
        ({"port": "pty", "baud": 0}, "--baud", "positive"),
        ({"baud": 9600}, "--baud", "--port"),
        ({"rs485": True}, "--rs485", "--port"),
        ({"serial_format": "8E1"}, "--serial-format", "--port"),
        ({"interface": "slcan", "channel": "x", "serial_format": "8E1"}, "--serial-format", "--port"),
        ({"port": "pty", "serial_format": "7E1"}, "--serial-format", "must be 8N1, 8E1"),
        ({"port": "pty", "serial_format": ""}, "--serial-format", "must be 8N1, 8E1"),
        ({"port": "pty", "rs485": True}, "--rs485", "a serial device"),
        ({"port": "udp:5600", "rs485": True}, "--rs485", "a serial device"),
        ({"interface": "slcan", "channel": "x", "rs485": True}, "--rs485", "--port"),
        ({"port": "udp:"}, "--port", "udp:PORT on this machine"),
        ({"port": "udp:bench"}, "--port", "udp:HOST:PORT"),
        ({"port": "udp:65536"}, "--port", "1 to 65535"),
        ({"port": "tcp:bench"}, "--port", "tcp:HOST:PORT"),
        ({"port": "tcp:0"}, "--port", "1 to 65535"),
        ({"port": "unix:"}, "--port", "unix:PATH"),
        ({"port": "pty:"}, "--port", "pty:LINK"),
        ({"port": "unix:x", "rs485": True}, "--rs485", "a serial device"),
        ({"port": "udp:::1:0"}, "--port", "1 to 65535"),
        ({"interface": "slcan", "channel": "x", "baud": 9600}, "--baud", "--port"),
        ({"interface": "slcan"}, "--channel", "the channel"),
        ({"interface": "virtual", "channel": "x"}, "--interface", "socketcan"),
        ({"channel": "vcan0"}, "--channel", "--interface"),
        ({"port": "pty", "fd": True}, "--fd", "--interface"),
        ({"bitrate": 500_000}, "--bitrate", "--interface"),
        ({"interface": "slcan", "channel": "x", "bitrate": -1}, "--bitrate", "positive"),
        ({"interface": "slcan", "channel": "x", "data_bitrate": 2_000_000}, "--data-bitrate", "--fd"),
    ],
)
def test_what_names_no_port_is_refused_by_its_option(
    options: dict[str, Any], option: str, allowed: str
) -> None:
    with pytest.raises(InputError) as refused:
        parse_port(**options)
    assert refused.value.where == option
    assert allowed in refused.value.remedy
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("port", "is_open"),
    [
        ("tcp:5600", False),
        ("tcp:localhost:5600", False),
        ("tcp:[::1]:5600", False),
        ("tcp:0.0.0.0:5600", True),
        ("tcp:[::]:5600", True),
        ("tcp:192.168.1.5:5600", True),
        ("udp:192.168.1.5:5600", False),
        ("unix:/tmp/lidar", False),
        ("pty", False),
    ],
)
def test_which_ports_other_machines_may_open(port: str, is_open: bool) -> None:
    assert parse_port(port).is_open is is_open
