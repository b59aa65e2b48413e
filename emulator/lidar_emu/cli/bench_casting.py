"""`lidar-emu bench casting`: rays onto an elevation grid, beside ray tracers of triangles."""

from __future__ import annotations

import json
from dataclasses import asdict

import click

from lidar_emu.cli.bench_realtime import show


@click.command(short_help="Rays onto an elevation grid, beside embreex and Open3D on the same ground.")
@click.option("--json", "as_json", is_flag=True, help="For machines.")
def casting(as_json: bool) -> None:
    """Time, error, lost rays and building of the caster of elevation grids, half a million cells, on one core.

    embreex and Open3D trace the same surface as a million triangles where they are installed (extra `peers`). Takes
    about half a minute and 2 GB with both. docs/casting.md explains the figures.

    \b
    lidar-emu bench casting
    lidar-emu bench casting --json
    """
    from lidar_emu.bench.casting import measure_casting

    report = measure_casting(show)
    show("")
    if as_json:
        click.echo(json.dumps(asdict(report), indent=2))
        return
    from lidar_emu.cli.bench_casting_table import print_casting

    print_casting(report)
