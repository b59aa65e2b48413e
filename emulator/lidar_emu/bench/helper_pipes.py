"""The helper process's ends of its pipes: JSON lines in and out, arrays at the end; imports little."""

from __future__ import annotations

import json
import os
from array import array
from contextlib import suppress
from typing import Any

_PIPE_BYTES = 65536
CONTROL, PARENT = 0, 1


def receive_message() -> dict[str, Any] | None:
    """The next message of the parent; None once the control pipe is closed."""
    line = b""
    while not line.endswith(b"\n"):
        byte = os.read(CONTROL, 1)
        if not byte:
            return None
        line += byte
    message: dict[str, Any] = json.loads(line)
    return message


def send_message(**values: object) -> None:
    """Send a message to the parent."""
    _write(json.dumps(values).encode() + b"\n")


def send_arrays(*arrays: array[int]) -> None:
    """Send the last message, the number of arrays, and then the arrays."""
    send_message(arrays=len(arrays))
    for values in arrays:
        _write(values.tobytes())


def _write(data: bytes) -> None:
    with suppress(BrokenPipeError):  # the parent was killed
        while data:
            data = data[os.write(PARENT, data) :]
