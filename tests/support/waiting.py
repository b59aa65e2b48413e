"""Waiting for events outside the test: the limit only ends a test that would wait for ever, on a busy machine too."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

LIMIT_S = 900.0


def eventually(condition: Callable[[], Any], limit_s: float = LIMIT_S) -> Any:
    """Wait until a condition of the outside world holds; returns what made it true."""
    deadline_s = time.monotonic() + limit_s
    while not (value := condition()):
        assert time.monotonic() < deadline_s, "it did not happen"
        time.sleep(0.005)
    return value
