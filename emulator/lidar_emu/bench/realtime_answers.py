"""What a process that measures beside the flight says to its parent; imports little."""

from __future__ import annotations

import json
import os
from array import array
from contextlib import suppress
from typing import Any

_PIPE_BYTES = 65536
LIFELINE, PARENT = 0, 1


def next_order() -> dict[str, Any] | None:
    """The next line that it is told; None at the end of its lifeline."""
    line = b""
    while not line.endswith(b"\n"):
        byte = os.read(LIFELINE, 1)
        if not byte:
            return None
        line += byte
    order: dict[str, Any] = json.loads(line)
    return order


def answer(**values: object) -> None:
    """Say a line."""
    _write(json.dumps(values).encode() + b"\n")


def answer_arrays(*arrays: array[int]) -> None:
    """The last answer: how many arrays, and what is in them."""
    answer(arrays=len(arrays))
    for values in arrays:
        _write(values.tobytes())


def _write(data: bytes) -> None:
    with suppress(BrokenPipeError):  # the parent was killed: nobody wants to know
        while data:
            data = data[os.write(PARENT, data) :]
