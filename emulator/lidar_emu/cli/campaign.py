"""`lidar-emu campaign`: many runs of a scenario, some of its keys drawn by chance."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.options import as_whole, keys_and_values, settings_option
from lidar_emu.cli.progress import COMPILING, busy
from lidar_emu.errors import Finding, InputError

if TYPE_CHECKING:
    from lidar_emu.campaign.pools import Pool
    from lidar_emu.campaign.read import Prepared
    from lidar_emu.campaign.run import Progress

_STATISTICS = "statistics.csv"


@click.command(short_help="Many runs with keys drawn by chance: tables, statistics, a picture.")
@click.argument("campaign")
@click.option(
    "--out", metavar="DIR", help="Folder of the results; one that holds a part of them is gone on with."
)
@click.option("--plan", is_flag=True, help="Fly a few runs and tell what all will take; nothing is kept.")
@click.option("--runs", metavar="N", help="Runs instead of the campaign's.")
@click.option("--workers", metavar="N", help="Processes. Left out: one for each core.")
@click.option(
    "--scheduler", metavar="ADDRESS", help="Fly on the workers of this Dask scheduler, e.g. tcp://host:8786."
)
@click.option("--plot", metavar="FILE.png", help="Picture: dropouts and errors by altitude and incidence.")
@settings_option
@click.option("--json", "as_json", is_flag=True, help="For machines.")
def campaign(
    campaign: str,
    out: str | None,
    plan: bool,
    runs: str | None,
    workers: str | None,
    scheduler: str | None,
    plot: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> None:
    """Fly CAMPAIGN, a YAML file that names a scenario, the keys of it that are drawn, and their distributions.

    In DIR are the tables `runs` and `beams` as Parquet files, and statistics.csv. What was interrupted (Ctrl-C, a
    crash, a power cut) is gone on with by the same command; docs/campaigns.md has all keys and columns.

    \b
    lidar-emu campaign dispersed_descent.yaml --plan
    lidar-emu campaign dispersed_descent.yaml --out results --plot results.png
    lidar-emu campaign my.yaml --out results --set level=spectral --workers 8
    lidar-emu campaign my.yaml --out /shared/results --scheduler tcp://head:8786
    """
    if (out is None) != plan:
        found = Finding("--out and --plan" if plan else "no output")
        raise InputError("campaign", None, found, "allowed: --out DIR, or --plan")
    if workers is not None and scheduler is not None:
        raise InputError("--workers", None, Finding("with --scheduler"), "allowed: one of them")
    slots = as_whole("--workers", workers) if workers is not None else _cores()
    count = None if runs is None else as_whole("--runs", runs)
    _check_extras(plot)
    from lidar_emu.campaign.read import prepare

    prepared = prepare(Path(campaign), keys_and_values(settings), count)
    if out is None:
        from lidar_emu.cli.campaign_plan import print_plan

        print_plan(prepared, slots, as_json)
        return
    progress = _fly(prepared, Path(out), _pool_maker(slots, scheduler))
    _conclude(prepared, Path(out), plot, progress, as_json)


def _cores() -> int:
    return len(os.sched_getaffinity(0))


def _check_extras(plot: str | None) -> None:
    from importlib.util import find_spec

    if find_spec("pyarrow") is None:
        allowed = "allowed after: pip install 'lidar-emu[tables]'"
        raise InputError("campaign", None, Finding("no pyarrow"), allowed)
    if plot is not None:
        from lidar_emu.report.campaign_plot import check_plot_path

        check_plot_path(Path(plot))


def _pool_maker(slots: int, scheduler: str | None) -> Callable[[], Pool]:
    from lidar_emu.campaign.pools import ClusterPool, LocalPool

    return (lambda: LocalPool(slots)) if scheduler is None else (lambda: ClusterPool(scheduler))


def _fly(prepared: Prepared, out: Path, make_pool: Callable[[], Pool]) -> Progress:
    from lidar_emu.campaign.run import fly_campaign
    from lidar_emu.shots.model import build_model, initial_state, measure

    with busy(COMPILING):
        # Once, here: the workers find the kernels compiled.
        model = build_model(prepared.first)
        measure(model, 0, 1, initial_state(model))
    last: list[Progress] = []
    try:
        with _shown(prepared.campaign.name, prepared.campaign.runs) as show:

            def told(progress: Progress) -> None:
                last[:] = [progress]
                show(progress)

            return fly_campaign(prepared, model.shot_count * model.beam_count, out, make_pool, told)
    except KeyboardInterrupt:
        if last:
            done = f"{last[0].done} of {last[0].runs} runs are kept"
            click.echo(f"interrupted: {done} in {out}; the same command goes on with them", err=True)
        raise


@contextmanager
def _shown(name: str, runs: int) -> Iterator[Callable[[Progress], None]]:
    """A bar on a terminal, nothing elsewhere."""
    if sys.stderr is None or not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress, TimeRemainingColumn

    columns = (*Progress.get_default_columns()[:-1], MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(name, total=runs)
        yield lambda progress: bar.update(task, completed=progress.done)


def _conclude(prepared: Prepared, out: Path, plot: str | None, progress: Progress, as_json: bool) -> None:
    from lidar_emu.campaign.statistics import LEVELS, campaign_statistics
    from lidar_emu.campaign.told import failures, plot_columns, rows, write_statistics

    with busy("counting"):
        bands = campaign_statistics(out)
        reasons = failures(out)
    write_statistics(bands, out / _STATISTICS)
    name, failed = prepared.campaign.name, sum(reasons.values())
    if plot is not None:
        from lidar_emu.report.campaign_plot import plot_campaign

        title = f"{name}: {progress.runs - failed} runs, bands of 95 % confidence"
        plot_campaign(plot_columns(bands), [f"{100 * level:g} %" for level in LEVELS], title, Path(plot))
        click.echo(f"{plot}: {name}", err=True)
    if as_json:
        told = {
            "name": name,
            "runs": progress.runs,
            "failed": failed,
            "reasons": reasons,
            "statistics": rows(bands),
        }
        click.echo(json.dumps(told, indent=2))
        return
    from lidar_emu.cli.campaign_table import print_statistics

    print_statistics(bands)
    for reason, many in reasons.items():
        click.echo(f"{many} failed: {reason}")
    click.echo(f"{out}: {progress.runs} runs, {failed} failed")
