"""The other ends of every kind of line, held by the test: what a host is to the device.

A far end names the port that the device opens (`spec`), reads, sends, disconnects without notice and reconnects.
Packets are numbered, and those read are reported by their numbers; a torn packet fails the test.
"""

from __future__ import annotations

import os
import select
import socket
import subprocess
import sys
import threading
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import serial
from serial.rfc2217 import PortManager
from waiting import LIMIT_S, eventually

from lidar_emu.transports.frames import Frame, pack_frames, unpack_frames
from lidar_emu.transports.serial_port import loopback_pair
from lidar_emu.transports.spec import Kind, PortSpec

ALL_BYTES = bytes(range(256))
_FRAMES = 3
_READ_BYTES = 65536


class FarEnd:
    """Base class of all far ends, with the packets of a byte link."""

    spec = PortSpec()
    loopback_fd: int | None = None
    fills = True
    """Whether the line fills up while nobody reads it."""
    reports_loss = True
    """Whether the line reports that the far end has gone."""
    can_reconnect = True
    outlives_device = True
    _number_at = 0

    def __init__(self) -> None:
        self.read_so_far = b""

    def attach(self, description: str) -> None:
        """The device has opened its port, under this name."""

    def packet(self, number: int) -> bytes:
        return number.to_bytes(4, "big") + 15 * ALL_BYTES

    def numbers(self) -> list[int]:
        """Numbers of the whole packets read so far; a partial one at the end is left out."""
        self.read_so_far += self.read()
        size = len(self.packet(0))
        whole = len(self.read_so_far) // size
        pieces = [self.read_so_far[size * k : size * (k + 1)] for k in range(whole)]
        found = [int.from_bytes(piece[self._number_at :][:4], "big") for piece in pieces]
        assert pieces == [self.packet(number) for number in found], "torn"
        return found

    def command(self) -> bytes:
        """Bytes that the far end may send."""
        return ALL_BYTES

    def read(self) -> bytes:
        """What has arrived since the last call."""
        raise AssertionError

    def send(self, data: bytes) -> None:
        raise AssertionError(data)

    def disconnect(self) -> None:
        """Disconnect as a killed process does, without notice."""

    def reconnect(self) -> None: ...

    def close(self) -> None:
        self.disconnect()


class Loopback(FarEnd):
    can_reconnect = False

    def __init__(self) -> None:
        super().__init__()
        self._near, self._far = loopback_pair()
        self._far.setblocking(False)
        self.loopback_fd = os.dup(self._near.fileno())
        self._near.close()

    def read(self) -> bytes:
        return _all_of(lambda: self._far.recv(_READ_BYTES))

    def send(self, data: bytes) -> None:
        self._far.send(data)

    def disconnect(self) -> None:
        self._far.close()


class Pty(FarEnd):
    """The device makes the pty; the far end opens its path."""

    spec = PortSpec(Kind.PTY)
    outlives_device = False

    def attach(self, description: str) -> None:
        self._path = description
        self.reconnect()

    def read(self) -> bytes:
        return _all_of(lambda: os.read(self._descriptor, _READ_BYTES))

    def send(self, data: bytes) -> None:
        os.write(self._descriptor, data)

    def disconnect(self) -> None:
        os.close(self._descriptor)
        self.read_so_far = b""

    def reconnect(self) -> None:
        self._descriptor = os.open(self._path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)


class Serial(FarEnd):
    """A serial device that can be unplugged: a link to a pty, whose master is the far end."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._link = folder / "port"
        self.reconnect()
        self.spec = self.named(str(self._link))

    def named(self, path: str) -> PortSpec:
        return PortSpec(Kind.SERIAL, path)

    def read(self) -> bytes:
        return _all_of(lambda: os.read(self._master, _READ_BYTES))

    def send(self, data: bytes) -> None:
        os.write(self._master, data)

    def disconnect(self) -> None:
        self._link.unlink()  # the system reuses the number of the pty
        os.close(self._slave)
        os.close(self._master)
        self.read_so_far = b""

    def reconnect(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._link.symlink_to(os.ttyname(self._slave))


class Socket(FarEnd):
    """A terminal server that passes bytes on unchanged."""

    def __init__(self) -> None:
        super().__init__()
        self._port = 0
        self.reconnect()
        self.spec = PortSpec(Kind.SERIAL, f"socket://127.0.0.1:{self._port}")

    def attach(self, description: str) -> None:  # noqa: ARG002
        self._accept(LIMIT_S)

    def read(self) -> bytes:
        self._accept(0.0)
        return b"" if self._connection is None else _all_of(lambda: self._received(self._connection))

    def send(self, data: bytes) -> None:
        assert self._connection is not None
        self._connection.sendall(data)

    def disconnect(self) -> None:
        for sock in (self._connection, self._server):
            if sock is not None:
                sock.close()
        self._connection = None
        self.read_so_far = b""

    def reconnect(self) -> None:
        self._connection: socket.socket | None = None
        self._server = socket.create_server(("127.0.0.1", self._port))
        self._port = self._server.getsockname()[1]

    def _received(self, connection: Any) -> bytes:
        data = bytes(connection.recv(_READ_BYTES))
        if not data:  # the device has closed it
            connection.close()
            self._connection = None
        return data

    def _accept(self, timeout_s: float) -> None:
        if self._connection is None and select.select([self._server], [], [], timeout_s)[0]:
            self._connection, _ = self._server.accept()
            self._connection.setblocking(False)


class Listening(FarEnd):
    """A host that connects to the address at which the device listens."""

    outlives_device = False

    def __init__(self, spec: PortSpec, family: int, address: Any) -> None:
        super().__init__()
        self.spec = spec
        self._family, self._address = family, address

    def attach(self, description: str) -> None:  # noqa: ARG002
        self.reconnect()

    def read(self) -> bytes:
        return _all_of(lambda: self._socket.recv(_READ_BYTES))

    def send(self, data: bytes) -> None:
        self._socket.sendall(data)

    def disconnect(self) -> None:
        self._socket.close()
        self.read_so_far = b""

    def reconnect(self) -> None:
        self._socket = socket.socket(self._family, socket.SOCK_STREAM)
        self._socket.connect(self._address)
        self._socket.setblocking(False)


class Tcp(Listening):
    def __init__(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            address = free.getsockname()
        super().__init__(PortSpec(Kind.TCP, f"127.0.0.1:{address[1]}", baud=0), socket.AF_INET, address)


class Unix(Listening):
    def __init__(self, folder: Path) -> None:
        path = str(folder / "lidar")
        super().__init__(PortSpec(Kind.UNIX, path, baud=0), socket.AF_UNIX, path)


class Telnet(Socket):
    """A terminal server of RFC 2217, by pyserial. A thread answers the device's negotiation; it takes no further data
    until `read` has fetched the last."""

    def __init__(self) -> None:
        super().__init__()
        self.spec = PortSpec(Kind.SERIAL, f"rfc2217://127.0.0.1:{self._port}")

    def attach(self, description: str) -> None:
        """Nothing to do: the negotiation is complete."""

    def read(self) -> bytes:
        data, self._unread = self._unread, b""
        return data

    def send(self, data: bytes) -> None:
        super().send(b"".join(self._manager.escape(data)))

    def disconnect(self) -> None:
        self._leaving.set()
        self._thread.join()
        super().disconnect()

    def reconnect(self) -> None:
        super().reconnect()
        self._unread = b""
        self._leaving = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def write(self, data: bytes) -> None:
        """Called by the manager."""
        if self._connection is not None:
            self._connection.sendall(data)

    def line_settings(self) -> tuple[int, str, int]:
        """Bit rate, parity and stop bits that the device has negotiated."""
        port = self._manager.serial
        return port.baudrate, port.parity, port.stopbits

    def _serve(self) -> None:
        while not self._leaving.is_set():
            if self._connection is None:
                self._accept(0.02)
                self._manager = PortManager(serial.serial_for_url("loop://"), self)
            elif self._unread or not select.select([self._connection], [], [], 0.02)[0]:
                self._leaving.wait(0.002)
            else:
                with suppress(ConnectionResetError):
                    self._unread = b"".join(self._manager.filter(self._received(self._connection)))


class Udp(FarEnd):
    fills = False

    def __init__(self, host: str = "127.0.0.1") -> None:
        super().__init__()
        self._address: Any = (host, 0)
        self._family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._peer: Any = None
        self.reconnect()
        self._address = self._socket.getsockname()
        self.spec = PortSpec(Kind.UDP, f"{f'[{host}]' if ':' in host else host}:{self._address[1]}", baud=0)

    def read(self) -> bytes:
        return _all_of(self._one)

    def send(self, data: bytes) -> None:
        self._socket.sendto(data, self._peer)

    def disconnect(self) -> None:
        self._socket.close()

    def reconnect(self) -> None:
        self._socket = socket.socket(self._family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind(self._address)

    def _one(self) -> bytes:
        data, self._peer = self._socket.recvfrom(_READ_BYTES)
        assert len(data) == len(self.packet(0)), "one packet, one datagram"
        return data


class CanFarEnd(FarEnd):
    """Packets of three frames."""

    _number_at = 6  # behind the head of the first frame's record

    def packet(self, number: int) -> bytes:
        return pack_frames(
            Frame(0x100 + part, number.to_bytes(4, "big") + bytes(4)) for part in range(_FRAMES)
        )

    def command(self) -> bytes:
        return pack_frames([Frame(0x130, b"\x01\x02")])


class Slcan(CanFarEnd, Serial):
    """An slcan adapter, by its protocol of text lines."""

    def __init__(self, folder: Path) -> None:
        self._lines = b""
        super().__init__(folder)

    def named(self, path: str) -> PortSpec:
        return PortSpec(Kind.CAN, interface="slcan", channel=path)

    def read(self) -> bytes:
        *lines, self._lines = (self._lines + super().read()).split(b"\r")
        frames = [line.decode("ascii") for line in lines if line[:1] == b"t"]
        return pack_frames(Frame(int(line[1:4], 16), bytes.fromhex(line[5:])) for line in frames)

    def send(self, data: bytes) -> None:
        lines = [f"t{frame.can_id:03X}{len(frame.data)}{frame.data.hex()}\r" for frame in unpack_frames(data)]
        super().send("".join(lines).encode())

    def disconnect(self) -> None:
        super().disconnect()
        self._lines = b""


class Bus(CanFarEnd):
    """Another program on a bus of python-can, which the bus does not report."""

    fills = False
    reports_loss = False

    def __init__(self, interface: str, channel: str) -> None:
        super().__init__()
        self.spec = PortSpec(Kind.CAN, interface=interface, channel=channel)
        self._joined = interface, channel
        self._bus: Any = None
        self.reconnect()

    def read(self) -> bytes:
        frames = []
        while (message := self._bus.recv(timeout=0)) is not None:
            frames.append(Frame(message.arbitration_id, bytes(message.data)))
        return pack_frames(frames)

    def send(self, data: bytes) -> None:
        import can

        for frame in unpack_frames(data):
            self._bus.send(can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False))

    def disconnect(self) -> None:
        self._bus.shutdown()

    def reconnect(self) -> None:
        import can

        interface, channel = self._joined
        self._bus = can.Bus(interface=interface, channel=channel, ignore_config=True)


class Virtual(Bus):
    def __init__(self) -> None:
        super().__init__("virtual", f"bus {id(self)}")


class Remote(Bus):
    """Another client of the server of python-can-remote, which runs in a separate process."""

    reports_loss = True

    def __init__(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            self._port = free.getsockname()[1]
        super().__init__("remote", f"127.0.0.1:{self._port}")

    def disconnect(self) -> None:
        self._server.kill()
        self._server.wait()
        self._bus.socket.close()  # the bus's own shutdown waits for the server
        self._bus._is_shutdown = True
        self.read_so_far = b""

    def reconnect(self) -> None:
        where = ["-H", "127.0.0.1", "-p", str(self._port)]
        command = [sys.executable, "-m", "can_remote", "-i", "virtual", "-c", "bus", *where]
        self._server = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        eventually(self._joins)

    def _joins(self) -> bool:
        with suppress(ConnectionRefusedError):  # until the server listens
            super().reconnect()
            return True
        return False


def _all_of(read: Any) -> bytes:
    """Everything that can be read without waiting."""
    pieces = []
    with suppress(BlockingIOError, ConnectionResetError):
        while piece := read():
            pieces.append(piece)
    return b"".join(pieces)


LINES: dict[str, Callable[[Path], FarEnd]] = {
    "loopback": lambda _: Loopback(),
    "pty": lambda _: Pty(),
    "serial": Serial,
    "socket": lambda _: Socket(),
    "rfc2217": lambda _: Telnet(),
    "tcp": lambda _: Tcp(),
    "unix": Unix,
    "udp": lambda _: Udp(),
    "udp6": lambda _: Udp("::1"),
    "slcan": Slcan,
    "virtual": lambda _: Virtual(),
    "remote": lambda _: Remote(),
}
"""Every kind of line by its name, made in a folder for its files."""
