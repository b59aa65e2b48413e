"""State of a SocketCAN interface and its socket, and the meaning of error frames.

Sources: linux/can/error.h, linux/if.h, linux/sock_diag.h; netdevice(7), socket(7).
"""

from __future__ import annotations

import fcntl
import socket
import struct
from contextlib import suppress

from lidar_emu.errors import InputError
from lidar_emu.transports.spec import PortSpec

_RECEIVE_BUFFER_BYTES = 4 << 20
_SO_RCVBUFFORCE = 33
_SO_MEMINFO, _MEMINFO_DROPS, _MEMINFO = 55, 8, struct.Struct("9I")
_SIOCGIFFLAGS, _SIOCGIFMTU = 0x8913, 0x8921
_IFF_UP, _IFF_RUNNING = 0x1, 0x40
_CANFD_MTU = 72
_INTERFACE = struct.Struct("16si20x")

_BUS_OFF, _RESTARTED, _CONTROLLER = 0x40, 0x100, 0x04
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


def lost_frames(sock: socket.socket) -> int:
    """Frames that the system has discarded because the socket was not read in time; counted modulo 2**32."""
    try:
        answer = sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
    except OSError:  # before Linux 4.12
        return 0
    return int(_MEMINFO.unpack(answer)[_MEMINFO_DROPS]) if len(answer) == _MEMINFO.size else 0


def is_bus_off(error_class: int) -> bool:
    """Whether an error frame with this identifier reports bus-off."""
    return bool(error_class & _BUS_OFF)


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
    """Read a number of an interface from the system: its flags or its MTU."""
    answer = fcntl.ioctl(sock, request, _INTERFACE.pack(interface.encode(), 0))
    number = int(_INTERFACE.unpack(answer)[1])
    return number & 0xFFFF if request == _SIOCGIFFLAGS else number
