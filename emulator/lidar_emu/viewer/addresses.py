"""Where viewers are shown: in a window, or served on this machine alone."""

from __future__ import annotations

import os
import socket
import sys

from lidar_emu.errors import Finding, InputError, reason_of

LOCAL = "127.0.0.1"
WEB_PORT, FOXGLOVE_PORT = 9090, 8765
"""The usual ports of Rerun's page, whose data have the next one, and of Foxglove's WebSocket."""


def web_address(port: int) -> str:
    """The address of Rerun's page."""
    return f"http://{LOCAL}:{port}?url=rerun%2Bhttp://{LOCAL}:{port + 1}/proxy"


def web_socket_address(port: int) -> str:
    """The address for Foxglove's "Open connection"."""
    return f"ws://{LOCAL}:{port}"


def check_free(option: str, *ports: int) -> None:
    """Refuse ports that something listens at.

    Args:
        option: the option that leads to them, for the error message.

    Raises:
        InputError: a port cannot be used.
    """
    for port in ports:
        try:
            socket.create_server((LOCAL, port)).close()
        except OSError as error:
            found = Finding(f"port {port}: {reason_of(error)}")
            raise InputError(option, None, found, "must be a free port") from None


def free_port() -> int:
    """A port that nothing listens at."""
    with socket.create_server((LOCAL, 0)) as server:
        return int(server.getsockname()[1])


def check_display(where: str, remedy: str) -> None:
    """Refuse a window where there is no display.

    Raises:
        InputError: neither X11 nor Wayland is there.
    """
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError(where, None, Finding("no display for a window"), remedy)
