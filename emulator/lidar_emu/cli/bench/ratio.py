"""The ratio of a benchmark to its peer, measured in the same run, and the bound to which a caller holds it."""

from __future__ import annotations

import click

from lidar_emu.cli.options import as_number
from lidar_emu.cli.terminal import print_note
from lidar_emu.errors import RunError


def _as_bound(_context: click.Context, _option: click.Parameter, text: str | None) -> float | None:
    return None if text is None else as_number("--at-least", text)


at_least_option = click.option(
    "--at-least",
    metavar="RATIO",
    callback=_as_bound,
    help="Exit 1 if the ratio printed last is less than this.",
)


def judge(ratio: float | None, of: str, bound: float | None) -> None:
    """Print a ratio to standard error, and hold it to a bound.

    Args:
        ratio: None: its peer is not installed, or nothing was measured.
        of: what is compared with what.

    Raises:
        RunError: the ratio is below the bound, or there is none.
    """
    if ratio is not None:
        print_note(f"ratio: {ratio:.3g} ({of})")
    if bound is None:
        return
    if ratio is None:
        raise RunError(f"--at-least {bound:g}: not measured: {of}")
    if not ratio >= bound:
        raise RunError(f"--at-least {bound:g}: the ratio is {ratio:.4g}: {of}")
