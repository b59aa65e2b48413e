"""Paths of Unix sockets that a process has left."""

from __future__ import annotations

import socket
import stat
from pathlib import Path


def remove_abandoned(path: str) -> None:
    """Remove a socket's path that a process which has ended has left."""
    if _is_abandoned(path):
        Path(path).unlink()


def _is_abandoned(path: str) -> bool:
    """Whether the path is the socket, of datagrams or a stream, of a process that has ended."""
    try:
        if not stat.S_ISSOCK(Path(path).stat().st_mode):
            return False
        # A live stream refuses a datagram socket by its type, and does not notice.
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as trial:
            trial.connect(path)
    except ConnectionRefusedError:
        return True
    except OSError:
        return False
    return False
