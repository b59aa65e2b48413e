"""Whole packets over real descriptors: a socket pair with little room, and ptys."""

from __future__ import annotations

import os
import socket
import termios
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from lidar_emu.errors import InputError
from lidar_emu.transports.byte_channel import DescriptorChannel
from lidar_emu.transports.link import LinkLostError
from lidar_emu.transports.pseudo_terminal import PtyChannel
from lidar_emu.transports.serial_port import loopback_pair, open_byte_channel
from lidar_emu.transports.spec import Kind, PortSpec

ALL_BYTES = bytes(range(256))


@pytest.fixture
def narrow() -> Iterator[tuple[DescriptorChannel, socket.socket]]:
    """A line that takes a few kilobytes at most, and less than a packet at a time."""
    near, far = socket.socketpair()
    near.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1)
    far.setblocking(False)
    yield DescriptorChannel(near.fileno(), "narrow", near.close), far
    near.close()
    far.close()


@pytest.fixture
def pty() -> Iterator[PtyChannel]:
    channel = PtyChannel()
    yield channel
    channel.close()


def reader_of(pty: PtyChannel) -> int:
    return os.open(pty.description, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)


def read_all(descriptor: int) -> bytes:
    data = b""
    while True:
        try:
            data += os.read(descriptor, 65536)
        except BlockingIOError:
            return data


def packet(number: int) -> bytes:
    return number.to_bytes(4, "big") * 1250


def test_a_closed_far_end_is_a_lost_link(narrow: tuple[DescriptorChannel, socket.socket]) -> None:
    channel, far = narrow
    assert channel.receive() == b""
    far.send(b"command")
    far.close()
    assert channel.receive() == b"command"
    with pytest.raises(LinkLostError):
        channel.receive()
    with pytest.raises(LinkLostError):
        channel.send(b"x")


def test_the_next_reader_gets_nothing_stale_and_no_torn_packet(pty: PtyChannel) -> None:
    reader = reader_of(pty)
    assert pty.connected()
    while pty.send(packet(1)):
        pass
    assert pty.pending
    os.close(reader)
    assert not pty.connected()
    reader = reader_of(pty)
    assert pty.connected()
    assert pty.send(b"fresh")
    assert read_all(reader) == b"fresh"
    assert not termios.tcgetattr(reader)[3] & termios.ICANON
    os.close(reader)


def test_a_pty_states_what_its_reader_has_not_fetched(pty: PtyChannel, eventually: Any) -> None:
    reader = reader_of(pty)
    pty.connected()
    pty.send(ALL_BYTES)
    eventually(lambda: pty.unread() == len(ALL_BYTES))
    read_all(reader)
    assert pty.unread() == 0
    os.close(reader)


def test_the_loopback_holds_hundreds_of_packets() -> None:
    near, far = loopback_pair()
    channel = DescriptorChannel(near.fileno(), "loopback", near.close)
    count = 0
    while channel.send(bytes(130)) and count < 100_000:
        count += 1
    assert count > 400
    near.close()
    far.close()


def test_a_line_states_what_has_not_arrived_yet(narrow: tuple[DescriptorChannel, socket.socket]) -> None:
    channel, far = narrow
    assert channel.unread() == 0
    while channel.send(packet(1)):
        pass
    assert channel.pending
    before = channel.unread()
    # What is partly written counts, and what the system holds.
    assert before > len(packet(1))
    read_all(far.fileno())
    assert 0 < channel.unread() < before
    while channel.pending:
        channel.flush()
        read_all(far.fileno())
    assert channel.unread() == 0


def test_a_port_without_a_queue_has_nothing_unread() -> None:
    ends = os.pipe()
    channel = DescriptorChannel(ends[1], "pipe", lambda: None)
    assert channel.unread() == 0
    for end in ends:
        os.close(end)
    assert channel.unread() == 0


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        ("/dev/nothing-of-the-kind", "no such port"),
        ("/dev/null", "not a serial device"),
        ("/dev", "folder"),
        ("nonsense://x", "a URL that pyserial knows"),
        ("socket://127.0.0.1:1", "refused"),
        ("rfc2217://127.0.0.1", "must be rfc2217://HOST:PORT"),
        ("rfc2217://127.0.0.1:1", "refused"),
    ],
)
def test_a_port_that_cannot_be_opened_is_named(path: str, reason: str) -> None:
    with pytest.raises(InputError, match=reason) as refused:
        open_byte_channel(PortSpec(Kind.SERIAL, path))
    assert refused.value.value == path


def test_a_url_without_a_descriptor_works() -> None:
    channel = open_byte_channel(PortSpec(Kind.SERIAL, "loop://"))
    assert channel.readable is None
    assert channel.receive() == b""
    assert channel.send(ALL_BYTES)
    assert channel.receive() == ALL_BYTES
    channel.close()
    with pytest.raises(LinkLostError):
        channel.send(b"x")


def test_a_pty_has_a_second_name_as_long_as_it_is_open(tmp_path: Path) -> None:
    link = tmp_path / "lidar"
    link.symlink_to("/dev/pts/999999")  # left by a killed process
    channel = open_byte_channel(PortSpec(Kind.PTY, str(link)))
    assert channel.description == str(link)
    host = os.open(link, os.O_RDWR | os.O_NOCTTY)
    assert channel.connected()
    assert channel.send(ALL_BYTES)
    assert os.read(host, 1000) == ALL_BYTES
    os.close(host)
    channel.close()
    assert not link.is_symlink()


def test_a_link_that_another_process_has_made_since_stays(tmp_path: Path) -> None:
    link = tmp_path / "lidar"
    channel = open_byte_channel(PortSpec(Kind.PTY, str(link)))
    link.unlink()
    link.symlink_to("/dev/pts/999999")
    channel.close()
    assert link.is_symlink()


def test_a_link_to_a_terminal_that_was_given_to_somebody_else_is_replaced(
    tmp_path: Path, raw_pty: Any
) -> None:
    link = tmp_path / "lidar"
    link.symlink_to(raw_pty.path)
    os.utime(link, ns=(0, 0), follow_symlinks=False)  # older than the terminal
    channel = open_byte_channel(PortSpec(Kind.PTY, str(link)))
    assert link.readlink() != Path(raw_pty.path)
    channel.close()
    assert not link.is_symlink()


def test_a_link_that_is_in_use_stays_whatever_its_times(tmp_path: Path) -> None:
    link = tmp_path / "lidar"
    channel = open_byte_channel(PortSpec(Kind.PTY, str(link)))
    os.utime(link, ns=(0, 0), follow_symlinks=False)
    terminal = link.readlink()
    terminal.chmod(0o666)  # so that another user can open it
    with pytest.raises(InputError, match="it exists"):
        open_byte_channel(PortSpec(Kind.PTY, str(link)))
    assert link.readlink() == terminal
    channel.close()
    assert not link.is_symlink()


@pytest.mark.parametrize(
    "obstacle", ["file", "folder", "link to a file", "dangling link", "link to a terminal"]
)
def test_what_is_in_the_way_of_a_link_stays(obstacle: str, tmp_path: Path, raw_pty: Any) -> None:
    link = tmp_path / "lidar"
    match obstacle:
        case "file":
            link.write_text("mine")
        case "folder":
            link.mkdir()
        case "link to a file":
            link.symlink_to(__file__)
        case "dangling link":
            link.symlink_to(tmp_path / "nowhere")
        case "link to a terminal":
            link.symlink_to(raw_pty.path)
    before = link.lstat().st_ino
    with pytest.raises(InputError, match="must be a path that does not exist yet: it exists") as refused:
        open_byte_channel(PortSpec(Kind.PTY, str(link)))
    assert refused.value.value == f"pty:{link}"
    assert link.lstat().st_ino == before


def test_a_link_needs_its_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file or directory"):
        open_byte_channel(PortSpec(Kind.PTY, str(tmp_path / "no" / "lidar")))


def test_a_device_that_vanished_has_gone_for_writers_as_for_readers() -> None:
    """What notices it first is chance: a write fails with EIO, a read finds the end."""
    far, near = os.openpty()
    channel = DescriptorChannel(near, "device", lambda: os.close(near))
    os.close(far)
    for use in (lambda: channel.send(b"x"), channel.receive):
        with pytest.raises(LinkLostError, match="the other end has gone"):
            use()
    channel.close()
