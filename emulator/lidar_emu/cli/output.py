"""Standard output that may be closed: a run does not end because its reader went away."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import click

from lidar_emu.errors import RunError, printable, reason_of

_failures: list[OSError] = []


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


def print_note(text: str) -> None:
    """Print a line to standard error."""
    click.echo(printable(text), err=True)


def check_printed() -> None:
    """Raise RunError if `print_line` has discarded lines, unless their reader went away."""
    if _failures:
        raise RunError(f"standard output: {reason_of(_failures[0])}")


def write_text(path: Path, text: str) -> None:
    """Write a text file.

    Raises:
        RunError: the file could not be written.
    """
    try:
        path.write_text(text)
    except OSError as error:
        raise RunError(f"{path}: could not be written: {error.strerror}") from None


def silence() -> None:
    """Redirect standard output to the null device, also where no further descriptor may be opened."""
    standard = sys.stdout.fileno()
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
    except OSError:
        os.close(standard)
        nowhere = os.open(os.devnull, os.O_WRONLY)
    if nowhere != standard:
        os.dup2(nowhere, standard)
        os.close(nowhere)
