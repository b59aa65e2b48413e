"""`lidar-emu bench campaign`: how fast campaigns are flown on this machine."""

from __future__ import annotations

import json
import os
from dataclasses import asdict

import click

from lidar_emu.cli.bench_realtime import show
from lidar_emu.cli.options import as_whole


@click.command(short_help="How many times faster than real time campaigns are, of one core and of all.")
@click.option("--workers", metavar="N", help="Processes at once. Left out: one for each core.")
@click.option("--runs", metavar="N", default="400", show_default=True, help="Runs for all of them together.")
@click.option("--json", "as_json", is_flag=True, help="For machines.")
def campaign(workers: str | None, runs: str, as_json: bool) -> None:
    """Fly runs of dispersed_descent.yaml, and compare their time with that of the flights, and with no pool at all.

    \b
    lidar-emu bench campaign
    lidar-emu bench campaign --runs 2000 --json
    """
    count = len(os.sched_getaffinity(0)) if workers is None else as_whole("--workers", workers)
    flown = as_whole("--runs", runs)
    from lidar_emu.bench.campaign import measure_cores, measure_scaling

    cores = measure_cores(show)
    scaling = measure_scaling(count, flown, show)
    show("")
    told = {
        "one_core": [
            {
                **asdict(core),
                "faster_than_real_time": core.flight_s / core.run_s,
                "faster_than_real_time_per_core": core.flight_s / core.core_s,
            }
            for core in cores
        ],
        "all": {**asdict(scaling), "pool_over_alone": scaling.alone_s / scaling.pool_s},
    }
    if as_json:
        click.echo(json.dumps(told, indent=2))
        return
    for core in cores:
        ratio, busy = core.flight_s / core.run_s, core.flight_s / core.core_s
        run = f"{core.run_s * 1e3:.1f} ms a run, {core.core_s * 1e3:.1f} ms of the processor"
        click.echo(f"{core.level}: {run}; {ratio:.0f} and {busy:.0f} times faster than real time")
    share = scaling.alone_s / scaling.pool_s
    both = f"pool {scaling.pool_s:.2f} s, on their own {scaling.alone_s:.2f} s"
    click.echo(
        f"{flown} runs by {count} processes: {both}; the pool reaches {100 * share:.0f} % of what they do"
    )
