"""pytest plugin for `mutants.py`: limits the time of each test, and records it while the map is made."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

LIMIT_S = float(os.environ["MUTANTS_LIMIT_S"])


class TimeIsUpError(BaseException):
    """Ends a test. Not an `Exception`: hypothesis would search for the smallest example that takes as long."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Iterator[None]:
    """End a test after the limit."""
    signal.signal(signal.SIGALRM, _end)
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S, 0.01)
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)


def _end(_: int, frame: FrameType | None) -> None:
    """Raise, unless in coverage, which would keep its lock forever; the next alarm then interrupts it elsewhere."""
    while frame is not None:
        if "/coverage/" in frame.f_code.co_filename:
            return
        frame = frame.f_back
    signal.setitimer(signal.ITIMER_REAL, 0)
    raise TimeIsUpError


def pytest_runtest_logreport(report: Any) -> None:
    """Record the time of each test."""
    file = os.environ.get("MUTANTS_SECONDS")
    if file and report.when == "call":
        with Path(file).open("a") as seconds:
            seconds.write(json.dumps([report.nodeid, report.duration, report.passed]) + "\n")
