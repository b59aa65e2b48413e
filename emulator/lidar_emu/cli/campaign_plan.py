"""`lidar-emu campaign --plan`: what a campaign will take."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.progress import COMPILING, busy

if TYPE_CHECKING:
    from lidar_emu.campaign.read import Prepared


def print_plan(prepared: Prepared, workers: int, as_json: bool) -> None:
    """Time, memory and disk, from a few runs flown here and now."""
    from lidar_emu.campaign.forecast import forecast

    with busy(COMPILING):
        told = forecast(prepared)
    if as_json:
        hours = told.hours(workers)
        click.echo(json.dumps({**told._asdict(), "workers": workers, "hours": hours}, indent=2))
        return
    campaign = prepared.campaign
    click.echo(
        f"{campaign.name}: {told.runs} runs of {campaign.scenario}, {campaign.sampling}, seed {campaign.seed}"
    )
    for key in campaign.drawn_keys:
        column = prepared.drawn.columns[key]
        click.echo(f"  {key}: {_range(column)}")
    faster = told.flight_s / told.run_s
    click.echo(
        f"a run takes {told.run_s * 1e3:.3g} ms of one core, {faster:.0f} times faster than it is flown"
    )
    click.echo(
        f"all take {_duration(told.hours(workers))} with {workers} workers, {_duration(told.hours(1))} of one core"
    )
    click.echo(
        f"memory {_size(told.process_bytes)} per worker; disk {_size(told.disk_bytes)}, {_size(told.run_bytes)} a run"
    )
    click.echo(f"(measured: {told.flown} runs flown one after another in one process of this machine)")


def _range(column: list[object]) -> str:
    numbers = [value for value in column if isinstance(value, int | float)]
    if len(numbers) < len(column):
        kinds = dict.fromkeys(json.dumps(value) for value in column)
        return ", ".join(list(kinds)[:4]) + (f" and {len(kinds) - 4} more" if len(kinds) > 4 else "")
    return f"{min(numbers):.6g} to {max(numbers):.6g}, mean {sum(numbers) / len(numbers):.6g}"


def _duration(hours: float) -> str:
    seconds = hours * 3600
    for unit, length_s in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length_s:
            return f"{seconds / length_s:.3g} {unit}"
    return f"{seconds:.3g} s"


def _size(count: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} TB"
