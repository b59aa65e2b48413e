"""While something takes its time: signs of life on a terminal, silence elsewhere, and an open ear for Ctrl-C."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any


@contextmanager
def busy(what: str) -> Iterator[None]:
    """Show `what` meanwhile; nothing where nobody looks.

    Raises:
        KeyboardInterrupt: at the end, where one got lost on the way.
    """
    with (
        _hearing_ctrl_c(),
        _status(what) if sys.stderr is not None and sys.stderr.isatty() else nullcontext(),
    ):
        yield


def _status(what: str) -> Any:
    from rich.console import Console

    return Console(stderr=True).status(what)


@contextmanager
def _hearing_ctrl_c() -> Iterator[None]:
    """The compiler calls back through ctypes, which passes no exception on: it prints a traceback and goes on."""
    lost: list[object] = []
    before = sys.unraisablehook

    def note(unraisable: Any) -> None:
        if unraisable.exc_type is KeyboardInterrupt:
            lost.append(unraisable.object)
        else:
            before(unraisable)

    sys.unraisablehook = note
    try:
        yield
    finally:
        sys.unraisablehook = before
    if lost:
        raise KeyboardInterrupt


COMPILING = "preparing (the first start compiles the kernels: about 20 s)"
