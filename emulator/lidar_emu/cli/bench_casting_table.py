"""The report of `lidar-emu bench casting` as tables."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.table import Table

from lidar_emu.bench.casting import BILINEAR, OURS, Built, CastingReport


def print_casting(report: CastingReport) -> None:
    """Times, errors, and what building takes."""
    console = Console()
    peers = [name for name in report.built if name != OURS]
    what = (
        "Microseconds per call, of lidar-emu onto triangles, as of the peers, and onto the bilinear surface."
    )
    console.print(what, "Errors are rms (max) against fractions.", highlight=False, soft_wrap=True)
    console.print(_times(report, peers))
    console.print(_checks(report, [OURS, *peers]))
    large = report.built_large
    lines = [f"four million cells: ready in {large.time_s:.2g} s and {_memory(large)}"]
    lines += [
        f"{name}: left out, {why} (pip install 'lidar-emu\\[peers]')" for name, why in report.absent.items()
    ]
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True)


def _times(report: CastingReport, peers: list[str]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    table.add_column("us (times triangles)")
    for name in ("triangles", "bilinear", *peers):
        table.add_column(name, justify="right")
    for kind, time_s in report.time_s.items():
        ours_s = time_s[OURS]
        cells = [f"{1e6 * time_s[name]:.1f}" for name in (OURS, BILINEAR)]
        cells += [f"{1e6 * time_s[name]:.1f} ({time_s[name] / ours_s:.1f})" for name in peers]
        table.add_row(kind, *cells)
    return table


def _checks(report: CastingReport, tools: list[str]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    table.add_column("")
    for name in tools:
        table.add_column(name, justify="right")
    for place, error_m in report.error_m.items():
        cells = (error_m[name] for name in tools)
        table.add_row(f"error, {place}, m", *(f"{rms:.1g} ({most:.1g})" for rms, most in cells))
    table.add_row(f"lost of {report.aimed:,} to edges", *(f"{report.lost[name]}" for name in tools))
    table.add_row("ready in s", *(f"{report.built[name].time_s:.2g}" for name in tools))
    table.add_row("memory", *(_memory(report.built[name]) for name in tools))
    return table


def _memory(built: Built) -> str:
    return "-" if built.memory_mb is None else f"{built.memory_mb:.0f} MB"
