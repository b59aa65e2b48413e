"""`lidar-emu bench campaign`: the speed of Monte Carlo campaigns on this machine."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.bench.ratio import at_least_option, judge
from lidar_emu.cli.options import as_whole
from lidar_emu.cli.output import print_line
from lidar_emu.cli.progress import show_step

if TYPE_CHECKING:
    from lidar_emu.bench.campaign import CoreSpeed, Scaling


@click.command(short_help="How many times faster than real time campaigns run, on one core and on all.")
@click.option("--workers", metavar="N", help="Worker processes.  [default: one per core]")
@click.option("--runs", metavar="N", default="400", show_default=True, help="Runs for all workers together.")
@at_least_option
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def campaign(workers: str | None, runs: str, as_json: bool, at_least: float | None) -> None:
    """Fly runs of dispersed_descent.yaml and compare their time with real time, and the pool with separate processes.

    The ratio is real time to processor time of a run at level spectral.

    \b
    lidar-emu bench campaign
    lidar-emu bench campaign --runs 2000 --json
    lidar-emu bench campaign --at-least 1500
    """
    from lidar_emu.bench.campaign import measure_cores, measure_scaling
    from lidar_emu.campaign.pools import usable_cores

    count = usable_cores() if workers is None else as_whole("--workers", workers)
    run_count = as_whole("--runs", runs)

    cores = measure_cores(show_step)
    scaling = measure_scaling(count, run_count, show_step)
    show_step("")
    if as_json:
        document = {
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
        print_line(json.dumps(document, indent=2))
    else:
        _print(cores, scaling)
    first = cores[0]
    judge(first.flight_s / first.core_s, f"real time to processor time at level {first.level}", at_least)


def _print(cores: list[CoreSpeed], scaling: Scaling) -> None:
    for core in cores:
        ratio, per_core = core.flight_s / core.run_s, core.flight_s / core.core_s
        run = f"{core.run_s * 1e3:.1f} ms a run, {core.core_s * 1e3:.1f} ms of processor time"
        print_line(f"{core.level}: {run}; {ratio:.0f} and {per_core:.0f} times faster than real time")
    share = scaling.alone_s / scaling.pool_s
    both = f"pool {scaling.pool_s:.2f} s, separate processes {scaling.alone_s:.2f} s"
    print_line(
        f"{scaling.runs} runs, {scaling.workers} processes: {both}; the pool reaches {100 * share:.0f} % of their rate"
    )
