"""What a serial device has besides bytes: owners, settings, a driver. The driver is faked, for a pty has none."""

from __future__ import annotations

import errno
import os
import subprocess
import termios
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from lidar_emu.errors import InputError
from lidar_emu.transports.link import Link
from lidar_emu.transports.opening import opener
from lidar_emu.transports.opening_problems import can_problem, serial_problem, users_of
from lidar_emu.transports.serial_port import (
    modem_lines,
    open_byte_channel,
    open_serial_host,
    request_driver_features,
)
from lidar_emu.transports.spec import Kind, PortSpec

NOT_A_DRIVER_OF_OURS = OSError(25, "Inappropriate ioctl for device")


def spec(path: str, **settings: Any) -> PortSpec:
    return PortSpec(Kind.SERIAL, path, **settings)


class Driver:
    """A port of pyserial's, whose driver can do some things."""

    def __init__(self, *can: str) -> None:
        self.can, self.done = can, list[str]()

    def set_low_latency_mode(self, on: bool) -> None:
        if "low_latency" not in self.can:
            raise ValueError("Failed to update ASYNC_LOW_LATENCY flag to True")
        self.done.append(f"low_latency {on}")

    @property
    def rs485_mode(self) -> object:
        return None

    @rs485_mode.setter
    def rs485_mode(self, settings: Any) -> None:
        if "rs485" not in self.can:
            raise ValueError("Failed to set RS485 mode")
        self.done.append(f"rs485, RTS while sending: {settings.rts_level_for_tx}")


def test_a_driver_that_can_is_asked_for_low_latency_and_for_rs485_where_it_is_wanted() -> None:
    driver = Driver("low_latency", "rs485")
    assert request_driver_features(driver, spec("x")).granted == ("low_latency",)
    driver_features = request_driver_features(driver, spec("x", rs485=True))
    assert driver_features.granted == ("low_latency", "rs485")
    assert not driver_features.missing
    assert driver.done == ["low_latency True", "low_latency True", "rs485, RTS while sending: True"]


def test_what_a_driver_cannot_do_is_reported_and_no_error(raw_pty: Any) -> None:
    assert list(request_driver_features(Driver(), spec("x", rs485=True)).missing) == ["low_latency", "rs485"]
    link = Link(opener(spec(raw_pty.path, rs485=True)))
    assert list(link.driver_features.missing) == ["low_latency", "rs485"]
    link.service(0)
    assert link.take_events() == []
    link.close()
    assert not link.driver_features.missing


@pytest.mark.parametrize(
    ("bits", "reported"),
    [(0x20, "modem lines: CTS on, DSR off, CD off"), (0x140, "modem lines: CTS off, DSR on, CD on")],
)
def test_modem_lines_are_reported_as_they_were_found(
    bits: int, reported: str, raw_pty: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert modem_lines(raw_pty.master) == [], "a pty has none"

    def answer(_: int, request: int, state: bytearray) -> int:
        assert request == termios.TIOCMGET
        state[:] = bits.to_bytes(4, "little")
        return 0

    monkeypatch.setattr("fcntl.ioctl", answer)
    assert modem_lines(3) == [reported]


def test_settings_that_another_program_changes_are_set_again_and_reported(raw_pty: Any) -> None:
    link = Link(opener(spec(raw_pty.path, baud=230_400)))
    before = termios.tcgetattr(raw_pty.master)
    subprocess.run(["stty", "-F", raw_pty.path, "9600", "echo", "icanon", "onlcr"], check=True)
    assert termios.tcgetattr(raw_pty.master) != before
    link.service(7)
    assert link.take_events() == [
        (7, "another program has changed the settings of the port; they were set again")
    ]
    assert termios.tcgetattr(raw_pty.master) == before
    link.service(8)
    assert link.take_events() == []
    link.close()


def test_who_uses_a_port_is_named_and_refused(tmp_path: Path) -> None:
    """Not this process, which has the port open, and not `cat` while it has the master end of the same pty as well."""
    master, slave = os.openpty()
    (tmp_path / "lidar").symlink_to(path := os.ttyname(slave))
    with subprocess.Popen(["cat"], stdin=subprocess.PIPE, pass_fds=[master, slave]):
        assert users_of(path) == ""
        os.close(master)
        with (
            subprocess.Popen(["cat"], stdin=subprocess.PIPE, pass_fds=[slave]) as user,
            pytest.raises(InputError, match=rf"in use by .*: cat \(process {user.pid}\); end it"),
        ):
            open_serial_host(spec(str(tmp_path / "lidar")))
        first = open_serial_host(spec(path))
        with pytest.raises(InputError, match="in use by another program"):  # it is locked
            open_byte_channel(spec(path))
        first.close()
    os.close(slave)
    assert users_of("/dev/nothing-of-the-kind") == ""
    with (
        subprocess.Popen(["cat"], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL),
        pytest.raises(InputError, match="not a serial device"),
    ):
        open_serial_host(spec("/dev/null"))


@pytest.mark.parametrize("other", [None, "9600"])
def test_a_host_restores_settings_that_no_other_program_changes(other: str | None, raw_pty: Any) -> None:
    expected = termios.tcgetattr(raw_pty.master)
    host = open_serial_host(spec(raw_pty.path, baud=115_200))
    assert termios.tcgetattr(raw_pty.master) != expected
    if other:
        subprocess.run(["stty", "-F", raw_pty.path, other], check=True)
        expected = termios.tcgetattr(raw_pty.master)
    host.close()
    assert termios.tcgetattr(raw_pty.master) == expected


@pytest.mark.parametrize(
    ("number", "port", "part"),
    [
        (errno.ENOENT, "/dev/ttyUSB9", "ports here: /dev/ttyACM0, /dev/ttyS0; a run makes one with"),
        (errno.EACCES, "/dev/null", "run: sudo usermod -aG dialout $USER, and log in again"),
        (errno.EAFNOSUPPORT, "socketcan vcan7", "-a can_raw vcan; without it, -i udp_multicast -c 239.0.0.1"),
        (errno.ENODEV, "socketcan vcan7", "sudo ip link add vcan7 type vcan && sudo ip link set vcan7 up"),
        (errno.ENODEV, "socketcan can0", "connect its adapter; without it, -i udp_multicast"),
        (errno.ENODEV, "udp_multicast 239.0.0.1", "sudo ip route add 239.0.0.1/32 dev lo"),
    ],
)
def test_what_can_be_done_is_stated(number: int, port: str, part: str, monkeypatch: Any) -> None:
    found = [SimpleNamespace(device=name) for name in ("/dev/ttyS0", "/dev/ttyACM0")]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: found)
    interface, _, channel = port.partition(" ")
    error = RuntimeError()
    error.__cause__ = cause = OSError(number, os.strerror(number))
    bus = PortSpec(Kind.CAN, interface=interface, channel=channel)
    assert part in str(can_problem(error, bus) if channel else serial_problem(cause, port))


def test_a_device_that_is_no_pty_is_marked_as_taken_and_given_back(
    raw_pty: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The pty stands for a device: if it is exclusive, only privileged users can open it; TIOCGEXCL reports that."""
    monkeypatch.setattr("lidar_emu.transports.serial_port._is_pty", lambda _: False)
    slave = os.open(raw_pty.path, os.O_RDWR | os.O_NOCTTY)
    channel = open_byte_channel(spec(raw_pty.path))
    assert is_exclusive(slave)
    channel.close()
    assert not is_exclusive(slave)
    os.close(slave)


def is_exclusive(descriptor: int) -> bool:
    import fcntl

    return bool(int.from_bytes(fcntl.ioctl(descriptor, 0x80045440, bytes(4)), "little"))  # TIOCGEXCL
