"""`lidar-emu bench casting`: rays onto an elevation grid, compared with ray tracers of triangles."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.bench.ratio import at_least_option, judge
from lidar_emu.cli.output import print_line
from lidar_emu.cli.progress import show_step

if TYPE_CHECKING:
    from rich.table import Table

    from lidar_emu.bench.casting import Built, CastingReport


@click.command(short_help="Rays onto an elevation grid, compared with embreex and Open3D on the same ground.")
@at_least_option
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def casting(as_json: bool, at_least: float | None) -> None:
    """Measure the ray caster on an elevation grid of half a million cells, on one core: time, errors, lost rays.

    embreex and Open3D trace the same surface as a million triangles if they are installed (extra `peers`). Takes
    about half a minute, and 2 GB with both. The ratio is that of embreex's time to ours for four beams of 61 beamlets.
    docs/evidence/casting.md explains the figures.

    \b
    lidar-emu bench casting
    lidar-emu bench casting --json
    lidar-emu bench casting --at-least 5
    """
    from lidar_emu.bench.casting import measure_casting, ratio_to_embreex
    from lidar_emu.bench.casting_scene import FOUR_BEAMS

    report = measure_casting(show_step)
    show_step("")
    if as_json:
        print_line(json.dumps(asdict(report), indent=2))
    else:
        _print(report)
    judge(ratio_to_embreex(report), f"time of embreex to ours, {FOUR_BEAMS} on triangles", at_least)


def _print(report: CastingReport) -> None:
    """Print times, errors, and the cost of building."""
    from lidar_emu.bench.casting import OURS
    from lidar_emu.cli.plain_console import PlainConsole

    console = PlainConsole()
    peers = [name for name in report.built if name != OURS]
    console.print(
        "Microseconds per call: lidar-emu on triangles, like the peers, and on the bilinear surface. "
        "Errors are rms (max) relative to exact fractions.",
        highlight=False,
        soft_wrap=True,
    )
    console.print(_times(report, peers))
    console.print(_checks(report, [OURS, *peers]))
    large = report.built_large
    lines = [f"four million cells: ready in {large.time_s:.2g} s and {_memory(large)}"]
    lines += [
        f"{name}: left out, {why} (pip install 'lidar-emu[peers]')" for name, why in report.absent.items()
    ]
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True)


def _times(report: CastingReport, peers: list[str]) -> Table:
    from lidar_emu.bench.casting import BILINEAR, OURS

    table = _table("us (times triangles)", "triangles", "bilinear", *peers)
    for kind, time_s in report.time_s.items():
        ours_s = time_s[OURS]
        cells = [f"{1e6 * time_s[name]:.1f}" for name in (OURS, BILINEAR)]
        cells += [f"{1e6 * time_s[name]:.1f} ({time_s[name] / ours_s:.1f})" for name in peers]
        table.add_row(kind, *cells)
    return table


def _checks(report: CastingReport, tools: list[str]) -> Table:
    table = _table("", *tools)
    for place, error_m in report.error_m.items():
        cells = (error_m[name] for name in tools)
        table.add_row(f"error, {place}, m", *(f"{rms:.1g} ({most:.1g})" for rms, most in cells))
    table.add_row(f"lost of {report.aimed:,} to edges", *(f"{report.lost[name]}" for name in tools))
    table.add_row("ready in s", *(f"{report.built[name].time_s:.2g}" for name in tools))
    table.add_row("memory", *(_memory(report.built[name]) for name in tools))
    return table


def _table(*headings: str) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    table.add_column(headings[0])
    for heading in headings[1:]:
        table.add_column(heading, justify="right")
    return table


def _memory(built: Built) -> str:
    return "-" if built.memory_mb is None else f"{built.memory_mb:.0f} MB"
