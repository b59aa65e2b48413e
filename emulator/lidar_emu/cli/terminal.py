"""Standard output that may be closed, and progress on a terminal."""

from __future__ import annotations

import os
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from threading import Event
from typing import Any

import click

from lidar_emu.errors import RunError, printable, reason_of
from lidar_emu.files import whole_file
from lidar_emu.numerics.compilation import ONCE, compilation_reported_to

_CONTINUED = " " * 11
_failures: list[OSError] = []
_silenced = Event()


def has_terminal() -> bool:
    """Whether standard output is a terminal that can show a live display."""
    return sys.stdout is not None and sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"


def print_line(text: str) -> None:
    """Print a line; once standard output is closed or full, discard this and all later lines."""
    try:
        click.echo(printable(text))
    except BrokenPipeError:
        silence()
    except OSError as error:
        _failures.append(error)
        silence()


def print_lines(lines: list[str]) -> None:
    """Print a summary; on a terminal its lines are broken at spaces, and continued below their text."""
    if has_terminal():
        width = shutil.get_terminal_size().columns
        lines = [
            textwrap.fill(line, width, subsequent_indent=_CONTINUED, break_on_hyphens=False) for line in lines
        ]
    print_line("\n".join(lines))


def print_note(text: str) -> None:
    """Print a line to standard error."""
    click.echo(printable(text), err=True)


def check_printed() -> None:
    """Raise RunError if `print_line` has discarded lines, unless their reader went away."""
    if _failures:
        raise RunError(f"standard output: {reason_of(_failures[0])}")


def write_text(path: Path, text: str) -> None:
    """Write a text file, of which an older one stays until the new one is complete; or to a pipe or a device.

    Raises:
        InputError: the path cannot be written.
        RunError: writing failed.
    """
    if path.is_file() or not path.exists():
        with whole_file(path.resolve()) as file:
            file.write(text.encode())
        return
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise RunError(f"{path}: could not be written: {error.strerror}") from None


def silence() -> None:
    """Redirect standard output to the null device, also where no further descriptor may be opened."""
    _silenced.set()
    standard = sys.stdout.fileno()
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
    except OSError:
        os.close(standard)
        nowhere = os.open(os.devnull, os.O_WRONLY)
    if nowhere != standard:
        os.dup2(nowhere, standard)
        os.close(nowhere)


def is_silenced() -> bool:
    """Whether standard output was found closed or full, so that nobody sees what is printed."""
    return _silenced.is_set()


PREPARING = "preparing"


@contextmanager
def busy(what: str) -> Iterator[None]:
    """Show `what` on a terminal during the block, with the time that it has taken, and each kernel that is compiled.

    Raises:
        KeyboardInterrupt: at the end of the block, if a callback swallowed one.
    """
    with _keep_ctrl_c():
        if not shows_progress():  # the log then has a line on compilation
            yield
            return
        numbers = count(1)

        def show_kernel(name: str) -> None:
            show(f"compiling ({ONCE}): kernel {next(numbers)}, {name.rpartition('.')[2]}")

        with _display(what) as show, compilation_reported_to(show_kernel):
            yield


def show_step(what: str) -> None:
    """Replace the status line on a terminal, shortened to its width; an empty text clears it."""
    if shows_progress():
        width = shutil.get_terminal_size().columns - 1
        click.echo(f"\r\x1b[K{printable(what)[:width]}", nl=False, err=True)


def duration_words(time_s: float) -> str:
    """A duration in two digits and the largest unit of which there are two."""
    units = ("days", 86_400), ("hours", 3600), ("minutes", 60)
    unit, length_s = next((each for each in units if time_s >= 2 * each[1]), ("s", 1))
    rounded = float(f"{time_s / length_s:.2g}")  # formatted again: 100 s, not 1e+02 s
    return f"{rounded:g} {unit}"


def shows_progress() -> bool:
    """Whether standard error is a terminal."""
    return sys.stderr is not None and sys.stderr.isatty()


@contextmanager
def _display(what: str) -> Iterator[Callable[[str], None]]:
    """Show a line with a spinner and the time; yields the function that replaces its text."""
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
