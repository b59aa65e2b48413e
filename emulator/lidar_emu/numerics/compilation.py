"""Compilation, which takes most of a first start: reports of it, and a second process that takes a share of it."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from lidar_emu.errors import note_once

_log = logging.getLogger(__name__)


ONCE = "once, for about half a minute"


def _to_the_log(kernel: str) -> None:
    note_once("compiling", f"compiling the kernels: {ONCE}")
    _log.info("compiling %s", kernel)


_report: Callable[[str], None] = _to_the_log
_starts: dict[str, Callable[[], Callable[[], object]]] = {}
_waits: dict[str, Callable[[], object]] = {}


def usable_cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def compile_beside(kernel: str, start: Callable[[], Callable[[], object]]) -> None:
    """Have a kernel compiled by a second process, from the first time that this process compiles another one.

    Args:
        kernel: full name of the kernel.
        start: starts the process, and returns what waits for its end.
    """
    _starts[kernel] = start


def report_compilation(kernel: str) -> bool:
    """Report that a kernel is compiled now, by its name; return whether a second process was waited for, so that the
    cache may have it."""
    _report(kernel)
    wait = _waits.pop(kernel, None)
    if wait is not None:
        wait()
        return True
    _starts.pop(kernel, None)
    while _starts:
        name, start = _starts.popitem()
        _waits[name] = start()
    return False


@contextmanager
def compilation_reported_to(report: Callable[[str], None]) -> Iterator[None]:
    """Call `report` with the name of each kernel that is compiled during the block, instead of writing to the log."""
    global _report
    before, _report = _report, report
    try:
        yield
    finally:
        _report = before
