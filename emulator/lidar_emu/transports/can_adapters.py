"""python-can's messages and adapters, and the state of SocketCAN.

slcan on a serial line and a bus behind a network, on which python-can itself would block, are written through a channel
that takes whole lines or nothing.

Sources: linux/can/error.h, linux/if.h, linux/sock_diag.h; netdevice(7), socket(7).
"""

from __future__ import annotations

import errno
import socket
import struct
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from lidar_emu.errors import InputError
from lidar_emu.transports.byte_channel import DescriptorChannel
from lidar_emu.transports.frames import Frame
from lidar_emu.transports.link import LinkDiagnostics
from lidar_emu.transports.spec import PortSpec

if TYPE_CHECKING:
    import can


def message_of(frame: Frame, time_s: float = 0.0, channel: str | None = None) -> can.Message:
    """A frame as python-can sends and logs it.

    Args:
        time_s: since 1970, for a log.
        channel: name of the bus, for a log.
    """
    from can import Message

    return Message(
        timestamp=time_s,
        arbitration_id=frame.can_id,
        data=frame.data,
        is_fd=frame.is_fd,
        bitrate_switch=frame.bitrate_switch,
        is_extended_id=frame.is_extended,
        channel=channel,
    )


def frame_of(message: can.Message) -> Frame:
    """A data frame that python-can has received or read."""
    return Frame(
        message.arbitration_id,
        bytes(message.data),
        message.is_fd,
        message.bitrate_switch,
        message.is_extended_id,
    )


_MESSAGE_TIMEOUT_S = 1.0


class _NonBlocking:
    """Replaces a serial port or a socket that would block, or spin, while the line is full."""

    def __init__(self, original: Any, lines: DescriptorChannel) -> None:
        self._original = original
        self._lines = lines
        self.write_timeout: float | None = None

    def write(self, line: bytes) -> int:
        if not self._lines.send(line):
            raise BlockingIOError(errno.EAGAIN, "the line is full")
        return len(line)

    def sendall(self, line: bytes) -> None:
        self.write(bytes(line))

    def flush(self) -> None:
        self._lines.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._original, name)


def nonblocking_slcan(bus: Any, spec: PortSpec) -> DescriptorChannel:
    """Make an slcan bus write its lines through the returned channel."""
    if spec.fd:
        bus.set_bitrate(spec.bitrate, spec.data_bitrate)
    port = bus.serialPortOrig
    lines = DescriptorChannel(port.fileno(), str(spec), port.close)
    bus.serialPortOrig = _NonBlocking(port, lines)
    return lines


def nonblocking_remote(bus: Any, spec: PortSpec) -> DescriptorChannel:
    """Make a bus of python-can-remote write its messages through the returned channel."""
    protocol, sock = bus.remote_protocol, bus.socket
    lines = DescriptorChannel(sock.fileno(), str(spec), sock.close)
    # The end of a message must follow within this time.
    sock.settimeout(_MESSAGE_TIMEOUT_S)
    protocol._ws.socket = _NonBlocking(sock, lines)

    def shut_down() -> None:
        """The library's own function would wait forever for the server's answer."""
        with suppress(Exception):
            protocol.close()
        lines.close()
        bus._is_shutdown = True

    bus.shutdown = shut_down
    return lines


_RECEIVE_BUFFER_BYTES = 4 << 20
_SO_RCVBUFFORCE = 33
_SO_MEMINFO, _MEMINFO_DROPS, _MEMINFO = 55, 8, struct.Struct("9I")
_SIOCGIFFLAGS, _SIOCGIFMTU = 0x8913, 0x8921
_IFF_UP, _IFF_RUNNING = 0x1, 0x40
_CANFD_MTU = 72
_INTERFACE = struct.Struct("16si20x")

BUS_OFF = 0x40
"""Bit of the identifier of an error frame that reports bus-off."""
_RESTARTED, _CONTROLLER = 0x100, 0x04
_CONTROLLER_STATES = {0x30: "error passive", 0x0C: "error warning", 0x40: "error active"}


def prepare_socket(sock: socket.socket, spec: PortSpec) -> None:
    """Enlarge the receive buffer of an opened socket, and check that its interface is up.

    Raises:
        InputError: frames cannot leave the interface.
    """
    enlarge_receive_buffer(sock)
    try:
        option, problem = _problem(sock, spec)
    except OSError as error:
        option, problem = "--channel", f"it cannot be opened: {error.strerror}"
    if problem:
        raise InputError(option, None, f"{spec.interface} {spec.channel}", problem)


def enlarge_receive_buffer(sock: socket.socket) -> None:
    """Enlarge the buffer as far as the system allows: otherwise a reader that is slow for a moment loses frames."""
    for option in (socket.SO_RCVBUF, _SO_RCVBUFFORCE):
        with suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, option, _RECEIVE_BUFFER_BYTES)


def count_losses(sock: socket.socket, before: int, diagnostics: LinkDiagnostics, what: str) -> int:
    """Note how many frames or datagrams the system has discarded since it had discarded `before`, because the socket
    was not read in time; return the count now, modulo 2**32."""
    counted = before
    with suppress(OSError):  # before Linux 4.12
        answer = sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
        if len(answer) == _MEMINFO.size:
            counted = int(_MEMINFO.unpack(answer)[_MEMINFO_DROPS])
    if lost := (counted - before) % 2**32:
        diagnostics.counts["lost_frames"] += lost
        diagnostics.events.append(f"{lost} received {what} lost: they arrived faster than they were read")
    return counted


def controller_state(error_class: int, data: bytes) -> str | None:
    """The controller state that an error frame reports; None if it reports none."""
    if error_class & _RESTARTED:
        return "restarted after bus-off"
    if error_class & _CONTROLLER and len(data) > 1:
        for bits, state in _CONTROLLER_STATES.items():
            if data[1] & bits:
                return state
    return None


def _problem(sock: socket.socket, spec: PortSpec) -> tuple[str, str]:
    """The wrong option, and why the interface cannot carry the frames of this port; empty if it can."""
    flags = _interface_number(sock, spec.channel, _SIOCGIFFLAGS)
    if not flags & _IFF_UP:
        return "--channel", f"the interface is down: ip link set {spec.channel} up"
    if not flags & _IFF_RUNNING:
        return "--channel", f"it has no carrier; after bus-off: ip link set {spec.channel} type can restart"
    if spec.fd and _interface_number(sock, spec.channel, _SIOCGIFMTU) < _CANFD_MTU:
        return "--fd", "the interface carries classic frames only (its MTU is not 72)"
    return "", ""


def _interface_number(sock: socket.socket, interface: str, request: int) -> int:
    import fcntl  # Linux alone has it, and recordings of CAN frames are read elsewhere, too.

    answer = fcntl.ioctl(sock, request, _INTERFACE.pack(interface.encode(), 0))
    number = int(_INTERFACE.unpack(answer)[1])
    return number & 0xFFFF if request == _SIOCGIFFLAGS else number
