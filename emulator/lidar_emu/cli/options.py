"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from lidar_emu.errors import InputError

Command = Callable[..., Any]

_SCENARIO_OPTIONS = (
    click.argument("scenario"),
    click.option("--duration", metavar="S", help="Fly only the first seconds."),
    click.option("--seed", metavar="N", help="Seed instead of the scenario's."),
    click.option(
        "--set",
        "settings",
        metavar="KEY=VALUE",
        multiple=True,
        help="Replace a key of the scenario, e.g. timing.rate_hz=100 (repeatable).",
    ),
)


def scenario_options(command: Command) -> Command:
    """Give a click command `scenario`, `duration`, `seed` and `settings`."""
    for option in reversed(_SCENARIO_OPTIONS):
        command = option(command)
    return command


def overrides(duration: str | None, seed: str | None, settings: tuple[str, ...]) -> dict[str, str]:
    """The options as overrides for `load`.

    Raises:
        InputError: a setting without a key or a value.
    """
    result = {}
    for setting in settings:
        key, separator, value = setting.partition("=")
        if not (key and separator and value):
            raise InputError("--set", None, setting, "allowed: KEY=VALUE, e.g. timing.rate_hz=100")
        result[key] = value
    if duration is not None:
        result["duration_s"] = duration
    if seed is not None:
        result["seed"] = seed
    return result
