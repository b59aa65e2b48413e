"""A request to the control socket of a run: a fault to inject, or commands. Systems without ports can load it."""

from __future__ import annotations

import json
import socket
import tempfile
from pathlib import Path
from typing import Any

from lidar_emu.errors import Finding, InputError, RunError

_REPLY_S, _LONGEST_REPLY_BYTES = 5.0, 65536


def request(path: str, text: str, option: str = "PATH", timeout_s: float = _REPLY_S) -> dict[str, Any]:
    """Send a datagram to the control socket at `path`, which `option` names; return the reply.

    Raises:
        RunError: there was no reply.
        InputError: `path` is not the socket of a run.
    """
    if not hasattr(socket, "AF_UNIX"):
        raise InputError(option, None, Finding("no Unix sockets on this system"), "use Linux")
    with (
        tempfile.TemporaryDirectory(prefix="lidar-emu-") as folder,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as requester,
    ):
        requester.bind(str(Path(folder) / "reply"))
        requester.settimeout(timeout_s)
        try:
            requester.sendto(text.encode(), path)
            reply: dict[str, Any] = json.loads(requester.recv(_LONGEST_REPLY_BYTES))
        except TimeoutError:
            raise RunError(f"{path}: no reply within {timeout_s:g} s") from None
        except OSError as error:
            found = Finding(f"{path}: {error.strerror or error}")
            raise InputError(option, None, found, "name the path of a run's --control") from None
    return reply
