"""CAN: frames through python-can's slcan on a pty, read as the lines that its document describes; and a bus
that fails as SocketCAN does."""

from __future__ import annotations

import os
import socket
from typing import Any

import can
import pytest

from lidar_emu.errors import InputError
from lidar_emu.transports.can_adapters import enlarge_receive_buffer, prepare_socket
from lidar_emu.transports.can_port import CanChannel, open_can
from lidar_emu.transports.frames import Frame, pack_frames, unpack_frames
from lidar_emu.transports.link import LinkLostError
from lidar_emu.transports.spec import Kind, PortSpec

SHOT = [Frame(0x100, bytes.fromhex("0011223344556677")), Frame(0x101, b"\xab"), Frame(0x7FF, b"")]
SHOT_LINES = [b"t10080011223344556677", b"t1011AB", b"t7FF0"]


def slcan(path: str, **settings: Any) -> PortSpec:
    return PortSpec(Kind.CAN, interface="slcan", channel=path, **settings)


def data_lines(data: bytes) -> list[bytes]:
    """Lines that carry frames; fails where the last one is torn."""
    assert data.endswith(b"\r")
    return [line for line in data.split(b"\r") if line[:1] in (b"t", b"T", b"d", b"b", b"B")]


def test_slcan_sets_the_bit_rate_and_carries_a_set_of_frames(raw_pty: Any) -> None:
    channel = open_can(slcan(raw_pty.path, bitrate=250_000))
    assert channel.send(pack_frames(SHOT))
    data = raw_pty.read()
    channel.close()
    assert b"S5\r" in data  # 250 kbit/s
    assert data_lines(data) == SHOT_LINES
    assert raw_pty.read() == b"C\r"


def test_slcan_carries_fd_frames(raw_pty: Any) -> None:
    channel = open_can(slcan(raw_pty.path, fd=True, data_bitrate=5_000_000))
    frames = [
        Frame(0x123, bytes(12), is_fd=True, bitrate_switch=True),
        Frame(0x1ABCDEF0, b"\1", is_extended=True),
    ]
    assert channel.send(pack_frames(frames))
    data = raw_pty.read()
    assert b"S6\rY5\r" in data
    assert data_lines(data) == [b"b1239" + b"00" * 12, b"T1ABCDEF0101"]
    channel.close()


def test_slcan_receives_and_passes_over_what_is_no_frame(raw_pty: Any) -> None:
    channel = open_can(slcan(raw_pty.path))
    assert channel.receive() == b""
    os.write(raw_pty.master, b"t1232AABB\rtXYZ\rr1230\r\rT0000012318000000000000000F\r")
    frames = []
    for _ in range(10):  # each line that makes no sense ends one call
        frames += unpack_frames(channel.receive())
    assert frames[0] == Frame(0x123, b"\xaa\xbb")
    assert channel.take_diagnostics().counts == {"ignored_frames": 2}
    assert [frame.can_id for frame in frames[1:]] == [0x123]
    channel.close()


@pytest.mark.parametrize(
    ("settings", "option", "allowed"),
    [
        ({"interface": "nonsense", "channel": "x"}, "--interface", "socketcan"),
        ({"interface": "slcan", "channel": "/dev/nothing-of-the-kind"}, "--channel", "No such file"),
        ({"interface": "socketcan", "channel": "no-such-bus"}, "--channel", "-i udp_multicast"),
    ],
)
def test_a_bus_that_cannot_be_opened_is_named(settings: dict[str, str], option: str, allowed: str) -> None:
    with pytest.raises(InputError, match=allowed) as refused:
        open_can(PortSpec(Kind.CAN, **settings))
    assert refused.value.where == option


@pytest.mark.parametrize(
    ("error", "reported"),
    [
        (
            NameError("name 'canOpenChannel' is not defined"),
            "NameError: name 'canOpenChannel' is not defined",
        ),
        (AttributeError("no\nlibrary"), "AttributeError: no library"),
        (KeyError("x"), "KeyError: 'x'"),
        (can.CanInitializationError("no adapter"), "opened: no adapter"),
    ],
)
def test_whatever_an_interface_without_its_driver_raises_is_the_users_to_mend(
    monkeypatch: pytest.MonkeyPatch, error: Exception, reported: str
) -> None:
    def fail(**_: object) -> None:
        raise error

    monkeypatch.setattr(can, "Bus", fail)
    with pytest.raises(InputError) as refused:
        open_can(PortSpec(Kind.CAN, interface="kvaser", channel="0"))
    assert refused.value.where == "--channel"
    assert refused.value.remedy.endswith(reported)


def test_a_bit_rate_that_the_adapter_cannot_do_is_named(raw_pty: Any) -> None:
    with pytest.raises(InputError, match="choose one of"):
        open_can(slcan(raw_pty.path, bitrate=123_456))


class FailingBus:
    """A bus that takes some frames, then fails in one of the ways that SocketCAN has."""

    def __init__(self, error: Exception) -> None:
        self.error = error
        self.room = 0
        self.sent: list[int] = []
        self.arrived: list[can.Message] = []

    def fileno(self) -> int:
        raise NotImplementedError

    def send(self, message: can.Message, timeout: float) -> None:
        assert timeout == 0
        if not self.room:
            raise self.error
        self.room -= 1
        self.sent.append(message.arbitration_id)

    def recv(self, timeout: float) -> can.Message | None:
        assert timeout == 0
        return self.arrived.pop(0) if self.arrived else None


def on(bus: Any) -> CanChannel:
    return CanChannel(bus, "bus")


@pytest.mark.parametrize(
    "error",
    [
        can.CanOperationError("Failed to transmit: No buffer space available", 105),
        can.CanOperationError("Transmit buffer full"),
        BlockingIOError(11, "again"),
    ],
)
def test_a_set_that_was_begun_is_completed_before_the_next(error: Exception) -> None:
    bus = FailingBus(error)
    channel = on(bus)
    assert not channel.send(pack_frames(SHOT))
    assert not channel.pending
    bus.room = 2
    assert channel.send(pack_frames(SHOT))
    assert channel.pending
    assert not channel.send(pack_frames(SHOT))
    bus.room = 10
    assert channel.flush()
    assert bus.sent == [frame.can_id for frame in SHOT]


def test_an_interface_that_is_down_is_a_lost_link() -> None:
    channel = on(FailingBus(can.CanOperationError("Failed to transmit: Network is down", 100)))
    with pytest.raises(LinkLostError, match="Network is down"):
        channel.send(pack_frames(SHOT))


def error_frame(error_class: int, controller: int = 0) -> can.Message:
    return can.Message(arbitration_id=error_class, data=bytes([0, controller]), is_error_frame=True)


def test_error_frames_are_no_data_and_report_when_the_controller_changes() -> None:
    bus = FailingBus(OSError())
    bus.arrived = [
        error_frame(0x80),
        error_frame(0x4, 0x08),
        error_frame(0x4, 0x04),
        error_frame(0x4, 0x20),
        can.Message(arbitration_id=5, data=b"\1", is_extended_id=False),
        error_frame(0x100),
        error_frame(0x4, 0x40),
    ]
    channel = on(bus)
    assert unpack_frames(channel.receive()) == [Frame(5, b"\1")]
    noticed = channel.take_diagnostics()
    assert noticed.counts == {"error_frames": 6}
    states = ["error warning", "error passive", "restarted after bus-off", "error active"]
    assert noticed.events == [f"CAN controller: {state}" for state in states]
    assert channel.take_diagnostics().events == []


def test_bus_off_is_a_lost_link() -> None:
    bus = FailingBus(OSError())
    bus.arrived = [error_frame(0x40)]
    channel = on(bus)
    with pytest.raises(LinkLostError, match="bus off"):
        channel.receive()
    assert channel.take_diagnostics().counts == {"error_frames": 1}


def test_a_socketcan_reader_gets_room() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        before = sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        enlarge_receive_buffer(sock)
        assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) > before


@pytest.mark.parametrize(
    ("flags", "mtu", "fd", "option", "reported"),
    [
        (0x80, 72, False, "--channel", "down: ip link set can7 up"),
        (0x81, 72, False, "--channel", "can7 type can restart"),
        (0xC1, 16, True, "--fd", "classic frames only"),
        (0xC1, 16, False, None, ""),
        (0xC1, 72, True, None, ""),
    ],
)
def test_an_interface_from_which_no_frame_can_leave_is_refused(
    flags: int, mtu: int, fd: bool, option: str | None, reported: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    numbers = {0x8913: flags, 0x8921: mtu}
    monkeypatch.setattr(
        "fcntl.ioctl", lambda _, request, asked: asked[:16] + numbers[request].to_bytes(24, "little")
    )
    spec = PortSpec(Kind.CAN, interface="socketcan", channel="can7", fd=fd)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        if option is None:
            prepare_socket(sock, spec)
            return
        with pytest.raises(InputError, match=reported) as refused:
            prepare_socket(sock, spec)
    assert refused.value.where == option
