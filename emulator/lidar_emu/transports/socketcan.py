"""What Linux knows about a CAN interface and a socket besides the frames, and what error frames mean.

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
    """Give an opened socket room, and see whether its frames can leave: it opens on a dead interface, too.

    Raises:
        InputError: they cannot.
    """
    enlarge_receive_buffer(sock)
    try:
        option, trouble = _trouble(sock, spec)
    except OSError as error:
        option, trouble = "--channel", f"it cannot be opened: {error.strerror}"
    if trouble:
        raise InputError(option, None, f"{spec.interface} {spec.channel}", trouble)


def enlarge_receive_buffer(sock: socket.socket) -> None:
    """A reader that is slow for a moment loses frames; give it room, as far as the system allows."""
    for option in (socket.SO_RCVBUF, _SO_RCVBUFFORCE):
        with suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, option, _RECEIVE_BUFFER_BYTES)


def lost_frames(sock: socket.socket) -> int:
    """Frames that the system has thrown away because the socket was not read in time; counted modulo 2**32."""
    try:
        told = sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
    except OSError:  # before Linux 4.12
        return 0
    return int(_MEMINFO.unpack(told)[_MEMINFO_DROPS]) if len(told) == _MEMINFO.size else 0


def is_bus_off(error_class: int) -> bool:
    """Whether an error frame with this identifier says that the controller has left the bus."""
    return bool(error_class & _BUS_OFF)


def controller_state(error_class: int, data: bytes) -> str | None:
    """The state that an error frame says the controller has come into, where it says so."""
    if error_class & _RESTARTED:
        return "restarted after bus-off"
    if error_class & _CONTROLLER and len(data) > 1:
        for bits, state in _CONTROLLER_STATES.items():
            if data[1] & bits:
                return state
    return None


def _trouble(sock: socket.socket, spec: PortSpec) -> tuple[str, str]:
    """The option at fault, and why the interface cannot carry the frames of this port; empty if it can."""
    flags = _ask(sock, spec.channel, _SIOCGIFFLAGS)
    if not flags & _IFF_UP:
        return "--channel", f"the interface is down: ip link set {spec.channel} up"
    if not flags & _IFF_RUNNING:
        return "--channel", f"it has no carrier; after bus-off: ip link set {spec.channel} type can restart"
    if spec.fd and _ask(sock, spec.channel, _SIOCGIFMTU) < _CANFD_MTU:
        return "--fd", "the interface carries classic frames only (its MTU is not 72)"
    return "", ""


def _ask(sock: socket.socket, interface: str, request: int) -> int:
    """A number about an interface: flags or MTU."""
    answer = fcntl.ioctl(sock, request, _INTERFACE.pack(interface.encode(), 0))
    number = int(_INTERFACE.unpack(answer)[1])
    return number & 0xFFFF if request == _SIOCGIFFLAGS else number
