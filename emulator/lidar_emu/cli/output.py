"""Standard output that may go away: a flight does not end because whoever read along has enough."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import click

from lidar_emu.errors import RunError


def say(text: str) -> None:
    """Print a line; where standard output is closed or full, this and all later lines go nowhere."""
    try:
        click.echo(text)
    except OSError:
        silence()


def write_text(path: Path, text: str) -> None:
    """Write a file that was promised.

    Raises:
        RunError: it could not be written.
    """
    try:
        path.write_text(text)
    except OSError as error:
        raise RunError(f"{path}: could not be written: {error.strerror}") from None


def silence() -> None:
    """From now on standard output goes nowhere."""
    with open(os.devnull, "w") as nowhere:  # noqa: PTH123
        os.dup2(nowhere.fileno(), sys.stdout.fileno())
