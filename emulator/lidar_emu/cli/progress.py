"""Progress of long steps on a terminal, nothing elsewhere; Ctrl-C keeps working."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import click

from lidar_emu.errors import printable
from lidar_emu.numerics.compilation import compilation_reported_to

PREPARING = "preparing"


@contextmanager
def busy(what: str) -> Iterator[None]:
    """Show `what` on a terminal during the block, with the time that it has taken, and each kernel that is compiled.

    Raises:
        KeyboardInterrupt: at the end of the block, if a callback swallowed one.
    """
    with (
        _keep_ctrl_c(),
        _display(what) as show,
        compilation_reported_to(lambda kernel: show(f"compiling (first start only, about 40 s): {kernel}")),
    ):
        yield


def show_step(what: str) -> None:
    """Replace the status line on a terminal; an empty text clears it."""
    if _is_terminal():
        click.echo(f"\r\x1b[K{printable(what)}", nl=False, err=True)


def _is_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()


@contextmanager
def _display(what: str) -> Iterator[Callable[[str], None]]:
    """Show a line with a spinner and the time; yields the function that replaces its text."""
    if not _is_terminal():
        yield lambda _text: None
        return
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    from lidar_emu.cli.plain_console import PlainConsole

    # A table shortens its columns where a terminal is narrow: the text, not the time.
    time = TimeElapsedColumn(table_column=Column(min_width=len("0:00:00")))
    columns = (
        SpinnerColumn(),
        time,
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True)),
    )
    with Progress(*columns, console=PlainConsole(stderr=True), transient=True) as progress:
        task = progress.add_task(what, total=None)
        yield lambda text: progress.update(task, description=text)


@contextmanager
def _keep_ctrl_c() -> Iterator[None]:
    """Raise a Ctrl-C that a ctypes callback of the compiler swmust be ctypes prints it and goes on."""
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
