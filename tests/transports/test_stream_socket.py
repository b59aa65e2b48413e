"""Sockets at which the device listens: one host at a time, and addresses that are taken."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import pytest

from lidar_emu.errors import InputError
from lidar_emu.transports.sockets import open_listening, open_stream_host
from lidar_emu.transports.spec import Kind, PortSpec


@pytest.fixture(params=["tcp", "unix"])
def spec(request: pytest.FixtureRequest, tmp_path: Path) -> PortSpec:
    """An address that is free."""
    if request.param == "unix":
        return PortSpec(Kind.UNIX, str(tmp_path / "lidar"))
    with socket.create_server(("127.0.0.1", 0)) as free:
        return PortSpec(Kind.TCP, f"127.0.0.1:{free.getsockname()[1]}")


def test_a_second_host_waits_for_the_first_to_go(spec: PortSpec, eventually: Any) -> None:
    device = open_listening(spec)
    assert not device.connected()
    assert not device.send(b"to nobody")
    first = open_stream_host(spec)
    eventually(device.connected)
    second = open_stream_host(spec)
    assert device.send(b"one")
    eventually(lambda: first.receive() == b"one")
    assert second.receive() == b""
    first.close()
    eventually(lambda: device.receive() == b"" and not device.pending and device.readable is None)
    eventually(device.connected)
    assert device.send(b"two")
    eventually(lambda: second.receive() == b"two")
    second.close()
    device.close()


def test_an_address_in_use_is_refused_and_free_again_after_the_end(spec: PortSpec) -> None:
    device = open_listening(spec)
    host = open_stream_host(spec)
    assert device.connected()
    with pytest.raises(InputError, match="it cannot be opened: Address already in use") as refused:
        open_listening(spec)
    assert refused.value.value == str(spec)
    device.close()
    with pytest.raises(InputError, match=r"Connection refused|No such file"):
        open_stream_host(spec)
    open_listening(spec).close()
    host.close()


def test_the_socket_of_a_dead_process_is_replaced_and_no_other_file(tmp_path: Path) -> None:
    path = tmp_path / "lidar"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as dead:
        dead.bind(str(path))
    open_listening(PortSpec(Kind.UNIX, str(path))).close()
    assert not path.exists()
    path.write_text("mine")
    with pytest.raises(InputError, match="Address already in use"):
        open_listening(PortSpec(Kind.UNIX, str(path)))
    assert path.read_text() == "mine"


@pytest.mark.parametrize("path", ["192.0.2.77:5600", "nosuch.invalid:5600"])
def test_an_address_of_another_machine_is_refused(path: str) -> None:
    with pytest.raises(InputError, match="it cannot be opened"):
        open_listening(PortSpec(Kind.TCP, path))
