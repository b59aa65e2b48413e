"""The host's end: pty, device, and links that come and go."""

from __future__ import annotations

import os
import tty
from pathlib import Path

import pytest

from lidar_emu.errors import InputError
from lidar_emu.transports.opening import ByteHost, open_host
from lidar_emu.transports.serial_port import open_byte_channel
from lidar_emu.transports.spec import Kind, PortSpec


def byte_host(spec: PortSpec) -> ByteHost:
    host = open_host(spec)
    assert isinstance(host, ByteHost)
    return host


def test_a_host_may_make_the_pty_that_the_device_opens() -> None:
    host = byte_host(PortSpec(Kind.PTY))
    assert host.read(0.0) == b""
    device = open_byte_channel(PortSpec(Kind.SERIAL, host.description))
    assert device.send(b"\x00\x03packet")
    assert host.read(1.0) == b"\x00\x03packet"
    device.send(b"last words")
    device.close()
    assert host.read(1.0) == b"last words"
    assert host.read(0.01) == b""
    device = open_byte_channel(PortSpec(Kind.SERIAL, host.description))
    assert device.send(b"back again")
    assert host.read(1.0) == b"back again"
    assert host.times_lost == 0
    device.close()
    host.close()


def test_a_host_opens_a_lost_port_again(tmp_path: Path) -> None:
    path = tmp_path / "port"
    master, slave = os.openpty()
    path.symlink_to(os.ttyname(slave))
    host = byte_host(PortSpec(Kind.SERIAL, str(path)))
    path.unlink()  # the next pty of anybody may get the same number
    os.close(slave)
    os.close(master)
    assert [host.read(0.01) for _ in range(3)] == [b""] * 3
    assert host.times_lost == 1
    master, slave = os.openpty()
    tty.setraw(slave)
    path.symlink_to(os.ttyname(slave))
    assert host.read(0.0) == b""
    os.write(master, b"back again")
    assert host.read(1.0) == b"back again"
    host.close()
    os.close(slave)
    os.close(master)


def test_a_vanished_pty_is_not_looked_for_under_its_number() -> None:
    """By then another terminal may have it."""
    master, slave = os.openpty()
    path = os.ttyname(slave)
    host = byte_host(PortSpec(Kind.SERIAL, path))
    os.close(slave)
    os.close(master)
    assert host.read(0.0) == b""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.write(master, b"somebody's secret")
    assert [host.read(0.01) for _ in range(3)] == [b""] * 3
    assert host.times_lost == 1
    host.close()
    os.close(slave)
    os.close(master)


def test_a_url_is_looked_at_from_time_to_time() -> None:
    host = byte_host(PortSpec(Kind.SERIAL, "loop://"))
    assert host.read(0.02) == b""
    host.close()


def test_a_host_needs_a_port() -> None:
    with pytest.raises(InputError, match="a device, a URL, udp:PORT or pty"):
        open_host(PortSpec())
