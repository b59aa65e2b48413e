"""Reports of compilation, which takes most of a first start: to the log, or to a program that displays it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from lidar_emu.errors import note_once

_log = logging.getLogger(__name__)


def _to_the_log(kernel: str) -> None:
    note_once("compiling", "compiling the kernels, at the first start only: about 40 s")
    _log.info("compiling %s", kernel)


_report: Callable[[str], None] = _to_the_log


def report_compilation(kernel: str) -> None:
    """Report that a kernel is compiled now, by its name."""
    _report(kernel)


@contextmanager
def compilation_reported_to(report: Callable[[str], None]) -> Iterator[None]:
    """Call `report` with the name of each kernel that is compiled during the block, instead of writing to the log."""
    global _report
    before, _report = _report, report
    try:
        yield
    finally:
        _report = before
