"""Standard output that may go away: a flight does not end because whoever read along has enough."""

from __future__ import annotations

import os
import sys

import click


def say(text: str) -> None:
    """Print a line; where standard output is closed or full, this and all later lines go nowhere."""
    try:
        click.echo(text)
    except OSError:
        silence()


def silence() -> None:
    """From now on standard output goes nowhere."""
    with open(os.devnull, "w") as nowhere:  # noqa: PTH123
        os.dup2(nowhere.fileno(), sys.stdout.fileno())
