"""What the user will not take: the option `--fail-on` of commands that send."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from lidar_emu.errors import InputError

if TYPE_CHECKING:
    from lidar_emu.runtime.summary import Tally

_FAILURES = ("late", "dropped")
fail_on_option = click.option(
    "--fail-on",
    metavar="WHAT",
    default="",
    help="Exit 1 if packets were late, or dropped (late,dropped: either), or Ctrl-C cut it short.",
)


def failures_named(text: str) -> set[str]:
    """What the option says.

    Raises:
        InputError: one of the words is not known.
    """
    names = {name.strip() for name in text.split(",") if name.strip()}
    for name in sorted(names - set(_FAILURES)):
        raise InputError("--fail-on", None, name, f"allowed: {', '.join(_FAILURES)}")
    return names


def has_failed(tally: Tally, interrupted: bool, failures: set[str]) -> bool:
    """Whether something was not what `--fail-on` asks for; what was cut short proves nothing."""
    lost = {"late": tally.late > 0, "dropped": tally.dropped > 0}
    return bool(failures) and (interrupted or any(lost[name] for name in failures))
