"""CAN through python-can: whole sets of frames, without blocking."""

from __future__ import annotations

import errno
import logging
import os
import select
import socket
from collections import deque
from typing import TYPE_CHECKING, Any

from lidar_emu.errors import InputError, did_you_mean, nearest, one_line
from lidar_emu.transports.byte_channel import DescriptorChannel
from lidar_emu.transports.can_adapters import (
    BUS_OFF,
    controller_state,
    count_losses,
    frame_of,
    message_of,
    nonblocking_remote,
    nonblocking_slcan,
    prepare_socket,
)
from lidar_emu.transports.frames import Frame, pack_frames, unpack_frames
from lidar_emu.transports.link import LinkLostError, PortChannel
from lidar_emu.transports.opening_problems import can_problem
from lidar_emu.transports.spec import PortSpec

if TYPE_CHECKING:
    import can

_RECEIVE_AT_MOST = 16  # decoding more in python-can would delay a shot
_FULL_ERRNOS = (errno.ENOBUFS, errno.EAGAIN)
_NONBLOCKING = {"slcan": nonblocking_slcan, "remote": nonblocking_remote}


class CanChannel(PortChannel):
    """An open bus. A set of frames that did not fit in whole is completed before the next one."""

    def __init__(self, bus: can.BusABC, description: str, lines: DescriptorChannel | None = None) -> None:
        super().__init__(description)
        self._bus = bus
        self._socket = _socket_of(bus)
        self._lines = lines
        self._rest: deque[can.Message] = deque()
        self._descriptor = _descriptor_of(bus)
        self._controller: str | None = None
        self._lost_frames = 0

    @property
    def pending(self) -> bool:
        return bool(self._rest) or (self._lines is not None and self._lines.pending)

    @property
    def readable(self) -> int | None:
        return self._descriptor

    @property
    def writable(self) -> int | None:
        # The descriptor of SocketCAN is writable even while frames are refused.
        return None if self._lines is None else self._lines.writable

    def send(self, payload: bytes) -> bool:
        if not self.flush():
            return False
        messages = deque(message_of(frame) for frame in unpack_frames(payload))
        count = len(messages)
        self._send_first_of(messages)
        if len(messages) == count > 0:
            return False
        self._rest = messages
        return True

    def flush(self) -> bool:
        self._send_first_of(self._rest)
        return not self._rest and (self._lines is None or self._lines.flush())

    def receive(self) -> bytes:
        frames: list[Frame] = []
        for _ in range(_RECEIVE_AT_MOST):
            if self._descriptor is not None and not _is_readable(self._descriptor):
                break
            message = self._receive_one()
            if message is None:
                break
            if message.is_error_frame:
                self._count_error(message)
            elif message.is_remote_frame:
                self._diagnostics.counts["ignored_frames"] += 1
            else:
                frames.append(frame_of(message))
        if self._socket is not None:
            self._lost_frames = count_losses(self._socket, self._lost_frames, self._diagnostics, "frames")
        return pack_frames(frames)

    def unread(self) -> int:
        # Bytes on their way to an slcan adapter; frames on a bus cannot be lost by closing it.
        return 0 if self._lines is None else self._lines.unread()

    def close(self) -> None:
        try:
            self._bus.shutdown()
        except Exception:
            port = getattr(self._bus, "serialPortOrig", None)
            if port is not None:
                port.close()

    def _send_first_of(self, messages: deque[can.Message]) -> None:
        while messages:
            try:
                self._bus.send(messages[0], timeout=0)
            except LinkLostError:
                raise
            except Exception as error:  # an adapter may raise anything
                if _is_full(error):
                    return
                raise LinkLostError(_text_of(error)) from None
            messages.popleft()

    def _count_error(self, message: can.Message) -> None:
        self._diagnostics.counts["error_frames"] += 1
        if message.arbitration_id & BUS_OFF:
            # The system continues to accept frames, and discards them.
            raise LinkLostError("bus off")
        state = controller_state(message.arbitration_id, bytes(message.data))
        if state not in (None, self._controller):
            self._diagnostics.events.append(f"CAN controller: {state}")
            self._controller = state

    def _receive_one(self) -> can.Message | None:
        try:
            return self._bus.recv(timeout=0)
        except (ValueError, LookupError):  # a line that is not slcan
            self._diagnostics.counts["ignored_frames"] += 1
            return None
        except Exception as error:
            raise LinkLostError(_text_of(error)) from None


def open_can(spec: PortSpec) -> CanChannel:
    """Open the bus that `spec` names.

    Raises:
        InputError: no such interface or channel, or values that the adapter does not support.
    """
    import can

    # Errors are raised; the library's log lines as well would mix with the user's output.
    logging.getLogger("can").setLevel(logging.CRITICAL)
    if spec.interface not in can.VALID_INTERFACES:
        known = sorted(can.VALID_INTERFACES - {"virtual"})
        remedy = f"{did_you_mean(nearest(spec.interface, known))}must be one of {', '.join(known)}"
        raise InputError("--interface", None, spec.interface, remedy)
    try:
        bus = can.Bus(interface=spec.interface, channel=spec.channel, ignore_config=True, **_settings(spec))
        lines = _NONBLOCKING[spec.interface](bus, spec) if spec.interface in _NONBLOCKING else None
    except Exception as error:  # without its vendor's driver an interface may raise anything
        reason = can_problem(error, spec) or f"it cannot be opened: {_kind_of(error)}{_text_of(error)}"
        raise InputError("--channel", None, f"{spec.interface} {spec.channel}", reason) from None
    channel = CanChannel(bus, str(spec), lines)
    sock = _socket_of(bus)
    if sock is not None:
        try:
            prepare_socket(sock, spec)
        except InputError:
            channel.close()
            raise
    return channel


def _settings(spec: PortSpec) -> dict[str, Any]:
    fd = {"fd": True, "data_bitrate": spec.data_bitrate} if spec.fd else {}
    slcan = {"sleep_after_open": 0, "timeout": 0} if spec.interface == "slcan" else {}
    return {"bitrate": spec.bitrate, **fd, **slcan}


def _socket_of(bus: object) -> socket.socket | None:
    sock = getattr(bus, "socket", None)
    return sock if isinstance(sock, socket.socket) and sock.family == socket.AF_CAN else None


def _descriptor_of(bus: can.BusABC) -> int | None:
    from can import CanError

    try:
        descriptor = bus.fileno()
    except (NotImplementedError, CanError, OSError):
        return None
    return descriptor if descriptor >= 0 else None


def _is_readable(descriptor: int) -> bool:
    try:
        return bool(select.select([descriptor], [], [], 0)[0])
    except (OSError, ValueError) as error:
        raise LinkLostError(str(error)) from None


def _is_full(error: Exception) -> bool:
    cause = error.__cause__ if error.__cause__ is not None else error
    number = getattr(error, "error_code", None) or getattr(cause, "errno", None)
    return number in _FULL_ERRNOS or "buffer full" in str(error)


def _kind_of(error: Exception) -> str:
    """Type of an error whose text alone is not clear; otherwise empty."""
    from can import CanError

    is_clear = isinstance(error, CanError | OSError | ValueError)
    return "" if is_clear else f"{type(error).__name__}: "


def _text_of(error: BaseException) -> str:
    cause = error.__cause__
    number = getattr(error, "error_code", None)
    if number is not None and isinstance(cause, OSError):
        return os.strerror(number)
    return one_line(f"{error}: {cause}" if cause is not None and str(cause) not in str(error) else str(error))
