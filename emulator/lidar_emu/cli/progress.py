"""Progress of long steps on a terminal, nothing elsewhere; Ctrl-C keeps working."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import click

COMPILING = "preparing (the first start compiles the kernels: about 20 s)"


@contextmanager
def busy(what: str) -> Iterator[None]:
    """Show `what` on a terminal during the block.

    Raises:
        KeyboardInterrupt: at the end of the block, if a callback swallowed one.
    """
    with (
        _keep_ctrl_c(),
        _status(what) if sys.stderr is not None and sys.stderr.isatty() else nullcontext(),
    ):
        yield


def show_step(what: str) -> None:
    """Replace the status line on a terminal; an empty text clears it."""
    if sys.stderr is not None and sys.stderr.isatty():
        click.echo(f"\r\x1b[K{what}", nl=False, err=True)


def _status(what: str) -> Any:
    from rich.console import Console

    return Console(stderr=True).status(what)


@contextmanager
def _keep_ctrl_c() -> Iterator[None]:
    """Raise a Ctrl-C that a ctypes callback of the compiler swallowed: ctypes prints it and goes on."""
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
