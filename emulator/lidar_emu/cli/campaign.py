"""`lidar-emu campaign`: Monte Carlo runs of a scenario with dispersed keys."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lidar_emu.cli.options import as_whole, check_plot, keys_and_values, plot_option, settings_option
from lidar_emu.cli.terminal import PREPARING, busy, print_line, print_note, shows_progress
from lidar_emu.errors import Finding, InputError, RunError

if TYPE_CHECKING:
    from lidar_emu.campaign.description import PreparedCampaign
    from lidar_emu.campaign.requirements import CampaignRequirement
    from lidar_emu.campaign.run import CampaignProgress, Pool
    from lidar_emu.campaign.sensitivity import FactorIndices
    from lidar_emu.campaign.statistics import BandStatistics, CampaignCounts, IntervalEstimate
    from lidar_emu.campaign.verdicts import Judgement, RequirementPlan

_STATISTICS = "statistics.csv"
_INDICES = "sensitivity.csv"
_HEADINGS = {"altitude_m": "altitude\n\nm", "true_incidence_deg": "incidence\n\n°"}


@click.command(short_help="Monte Carlo runs with dispersed keys: tables, statistics, a plot.")
@click.argument("campaign")
@click.option("--out", metavar="DIR", help="Folder of the results; an unfinished campaign in it is resumed.")
@click.option("--plan", is_flag=True, help="Fly a few runs and estimate time, memory and disk; keep nothing.")
@click.option("--runs", metavar="N", help="Number of runs, instead of the campaign's.")
@click.option("--workers", metavar="N", help="Worker processes.  [default: one per core]")
@click.option(
    "--scheduler", metavar="ADDRESS", help="Fly on the workers of this Dask scheduler, e.g. tcp://host:8786."
)
@plot_option("dropouts and errors by altitude and incidence")
@click.option(
    "--requirements", metavar="FILE.yaml", help="Judge these requirements: pass, fail or not enough runs."
)
@click.option(
    "--sensitivity",
    is_flag=True,
    help="Compute Sobol indices: how much each key contributes to the variance of errors and dropouts.",
)
@click.option(
    "--column", "columns", metavar="NAME", multiple=True, help="Indices of a further column (repeatable)."
)
@settings_option
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def campaign(
    campaign: str,
    out: str | None,
    plan: bool,
    runs: str | None,
    workers: str | None,
    scheduler: str | None,
    plot: tuple[str, ...],
    requirements: str | None,
    sensitivity: bool,
    columns: tuple[str, ...],
    settings: tuple[str, ...],
    as_json: bool,
) -> None:
    """Fly CAMPAIGN, a YAML file that names a scenario, its dispersed keys, and their distributions.

    DIR receives the tables `runs` and `beams` as Parquet files, and statistics.csv. The same command resumes a campaign
    that was interrupted (Ctrl-C, a crash, a power cut). docs/campaigns.md has all keys and columns,
    docs/requirements.md those of requirements: exit code 1 if one does not pass.

    \b
    lidar-emu campaign dispersed_descent.yaml --plan
    lidar-emu campaign dispersed_descent.yaml --out results --plot results.png
    lidar-emu campaign my.yaml --out results --set level=spectral --workers 8
    lidar-emu campaign my.yaml --out /shared/results --scheduler tcp://head:8786
    lidar-emu campaign my.yaml --out results --requirements requirements.yaml
    lidar-emu campaign dispersed_descent.yaml --out sources --sensitivity --plot sources.png
    """
    if (out is None) != plan:
        from lidar_emu.campaign.description import read_campaign

        read_campaign(Path(campaign))  # a scenario in its place is to be named first
        found = Finding("--out and --plan" if plan else "no output")
        raise InputError("campaign", None, found, "pass --out DIR, or --plan")
    if workers is not None and scheduler is not None:
        raise InputError("--workers", None, Finding("with --scheduler"), "pass one of them")
    from lidar_emu.numerics.compilation import usable_cores

    slots = as_whole("--workers", workers) if workers is not None else usable_cores()
    count = None if runs is None else as_whole("--runs", runs)
    from lidar_emu.files import check_extra

    check_extra("campaign", "tables", "pyarrow", "tables")
    check_plot(plot)
    from lidar_emu.campaign.description import prepare
    from lidar_emu.scenario.load import settings_to_changes

    prepared = prepare(Path(campaign), settings_to_changes(keys_and_values(settings)), count, sensitivity)
    _check_columns(prepared, columns)
    plans, required = _required(requirements, prepared)
    if out is None:
        _print_plan(prepared, slots, plans, as_json)
        return
    _note_weak(plans, prepared.campaign.sampling)
    from lidar_emu.campaign.run import ClusterPool, LocalPool

    slots = min(slots, prepared.campaign.runs)
    with closing(LocalPool(slots) if scheduler is None else ClusterPool(scheduler)) as pool:
        counts = _fly(prepared, Path(out), pool)
    if prepared.campaign.sampling == "saltelli":
        _conclude_sensitivity(prepared, Path(out), plot, columns, counts, as_json)
        return
    judged: list[Judgement] = []
    if required:
        from lidar_emu.campaign.verdict_files import judge_campaign

        with busy("judging the requirements"):
            judged = judge_campaign(required, prepared, Path(out))
    _conclude(prepared, Path(out), plot, counts, judged, as_json)
    if short := [f"{one.requirement.id} ({one.verdict})" for one in judged if one.verdict != "pass"]:
        raise RunError(f"{len(short)} of {len(judged)} requirements do not pass: {', '.join(short)}")


def _required(
    requirements: str | None, prepared: PreparedCampaign
) -> tuple[list[RequirementPlan], list[CampaignRequirement]]:
    from lidar_emu.campaign.requirements import read_requirements
    from lidar_emu.campaign.verdicts import plan_requirement

    if requirements is None:
        return [], []
    if prepared.campaign.sampling == "saltelli":
        found = Finding("with --sensitivity, whose runs are not independent")
        raise InputError("--requirements", None, found, "judge them by a campaign of its own")
    required = read_requirements(Path(requirements))
    return [plan_requirement(one, prepared.campaign) for one in required], required


def _note_weak(plans: Sequence[RequirementPlan], sampling: str) -> None:
    """Note, before a campaign is flown, what its runs cannot show."""
    for planned in plans:
        if planned.most_misses < 0:
            print_note(str(planned))
    if plans and sampling != "random":
        print_note(f"sampling is {sampling}: the confidence of verdicts is exact for random sampling only")


def _check_columns(prepared: PreparedCampaign, columns: Sequence[str]) -> None:
    from lidar_emu.campaign.sensitivity import check_columns

    if columns and prepared.campaign.sampling != "saltelli":
        raise InputError("--column", None, Finding("without --sensitivity"), "pass both")
    check_columns("--column", prepared.campaign, columns)


def _fly(prepared: PreparedCampaign, out: Path, pool: Pool) -> CampaignCounts:
    from lidar_emu.campaign.run import compile_kernels, fly_campaign

    with busy(PREPARING):
        beams = compile_kernels(prepared, pool)
    last: list[CampaignProgress] = []
    try:
        with _progress_bar(prepared.campaign.name, prepared.campaign.runs) as show:

            def on_progress(progress: CampaignProgress) -> None:
                last[:] = [progress]
                show(progress)

            return fly_campaign(prepared, beams, out, pool, on_progress)[1]
    except KeyboardInterrupt:
        if last:
            done = f"{last[0].done} of {last[0].runs} runs are complete"
            print_note(f"interrupted: {done} in {out}; the same command resumes the campaign")
        raise


@contextmanager
def _progress_bar(name: str, runs: int) -> Iterator[Callable[[CampaignProgress], None]]:
    if not shows_progress():
        yield lambda _: None
        return
    from rich.progress import MofNCompleteColumn, Progress, TimeRemainingColumn

    from lidar_emu.cli.plain_console import PlainConsole

    columns = (*Progress.get_default_columns()[:-1], MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=PlainConsole(stderr=True), transient=True) as bar:
        task = bar.add_task(name, total=runs)
        yield lambda progress: bar.update(task, completed=progress.done)


def _conclude(
    prepared: PreparedCampaign,
    out: Path,
    plot: tuple[str, ...],
    counts: CampaignCounts,
    judged: Sequence[Judgement],
    as_json: bool,
) -> None:
    from lidar_emu.campaign.statistics import AXES, LEVELS, plot_columns, rows, write_rows

    with busy("computing the statistics"):
        bands = counts.statistics()
    write_rows(rows(bands), out / _STATISTICS)
    summary = _summary(prepared, counts)
    for path in plot:
        from lidar_emu.report.statistics_plots import plot_campaign

        name, flown = summary["name"], summary["runs"] - summary["failed"]
        shots = f"{sum(band.expected for band in bands if band.axis == AXES[0].name):,}".replace(",", " ")
        title = f"{name}: {flown} flights, {shots} beam shots"
        levels = [f"{100 * level:.0f}th percentile" for level in LEVELS]
        plot_campaign(plot_columns(bands), levels, title, Path(path))
        print_note(f"{path}: {name}")
    if as_json:
        verdicts = {"requirements": [one.document() for one in judged]} if judged else {}
        print_line(json.dumps({**summary, **verdicts, "statistics": rows(bands)}, indent=2))
        return
    _print_statistics(bands)
    _print_judgements(judged, prepared)
    _print_summary(summary, out)


def _conclude_sensitivity(
    prepared: PreparedCampaign,
    out: Path,
    plot: tuple[str, ...],
    columns: Sequence[str],
    counts: CampaignCounts,
    as_json: bool,
) -> None:
    from lidar_emu.campaign.sensitivity import (
        factor_label,
        index_rows,
        sensitivity_indices,
        sensitivity_panels,
    )
    from lidar_emu.campaign.statistics import write_rows

    with busy("computing the indices"):
        indices = sensitivity_indices(out, prepared.campaign, columns)
    rows = index_rows(indices)
    write_rows(rows, out / _INDICES)
    summary = _summary(prepared, counts)
    for path in plot:
        from lidar_emu.report.statistics_plots import plot_sensitivity

        samples = max(one.samples for one in indices)
        title = f"{summary['name']}: Sobol indices of {summary['runs']} runs, {samples} samples"
        factors = [factor_label(factor) for factor in dict.fromkeys(one.factor for one in indices)]
        plot_sensitivity(sensitivity_panels(indices), factors, title, Path(path))
        print_note(f"{path}: {summary['name']}")
    if as_json:
        print_line(json.dumps({**summary, "sensitivity": rows}, indent=2))
        return
    _print_indices([one for one in indices if one.low_m != one.low_m])
    print_line(f"by altitude: {out / _INDICES}")
    _print_summary(summary, out)


def _summary(prepared: PreparedCampaign, counts: CampaignCounts) -> dict[str, Any]:
    reasons = dict(sorted(counts.reasons.items(), key=lambda item: (-item[1], item[0])))
    campaign, failed = prepared.campaign, counts.reasons.total()
    return {"name": campaign.name, "runs": campaign.runs, "failed": failed, "reasons": reasons}


def _print_summary(summary: dict[str, Any], out: Path) -> None:
    for reason, count in summary["reasons"].items():
        print_line(f"{count} failed: {reason}")
    print_line(f"{out}: {summary['runs']} runs, {summary['failed']} failed")


def _print_indices(indices: Sequence[FactorIndices]) -> None:
    """Print a table per output of the whole flight, the largest total index first."""
    from lidar_emu.cli.plain_console import PlainConsole, plain_table

    console = PlainConsole()
    for name in dict.fromkeys(one.output for one in indices):
        of_output = [one for one in indices if one.output == name]
        samples, sigma = of_output[0].samples, of_output[0].sigma
        if not any(one.total.value == one.total.value for one in of_output):
            print_line(f"{name}: no indices: sigma {sigma:.3g} in {samples} samples")
            continue
        table = plain_table(
            f"{name}: sigma {sigma:.3g}, {samples} samples", "first", " ± 95 %", "  total", " ± 95 %", texts=1
        )
        for one in sorted(of_output, key=lambda each: -each.total.value):
            shares = (
                f"{each:.3f}"
                for kind in (one.first, one.total)
                for each in (kind.value, kind.high - kind.value)
            )
            table.add_row(one.factor, *shares)
        console.print(table)


def _print_judgements(judged: Sequence[Judgement], prepared: PreparedCampaign) -> None:
    from lidar_emu.campaign.verdict_files import describe_miss, evidence

    for one in judged:
        print_line(f"{one.requirement.id}: {one.verdict}")
        for line in evidence(one):
            print_line(f"  {line}")
        if one.missed and one.verdict != "pass":
            print_line(f"  worst {describe_miss(one.missed[0], prepared)}")
    if judged:
        print_line(
            "verdicts: requirements.xml (JUnit), requirements.sdoc (StrictDoc); misses.csv has all misses"
        )


def _print_statistics(bands: Sequence[BandStatistics]) -> None:
    """Print a table per axis, with the intervals of the dropouts; the CSV file has the intervals of the errors too."""
    from lidar_emu.cli.plain_console import PlainConsole, plain_table

    console = PlainConsole()
    for axis, heading in _HEADINGS.items():
        table = plain_table(
            heading, "beams", "lost\n\n%", "95 % con-\nfidence\n%",
            "range\nerror\np5", "\n\np50", "\nm\np95", "speed\nerror\np5", "\n\np50", "\nmm/s\np95",
        )  # fmt: skip
        for band in (band for band in bands if band.axis == axis):
            table.add_row(
                f"{band.low:g}-{band.high:g}",
                str(band.expected),
                f"{100 * band.dropout.value:.2f}",
                f"{100 * band.dropout.low:.2f}-{100 * band.dropout.high:.2f}",
                *_values(band.quantiles["range_error_m"], 1.0),
                *_values(band.quantiles["speed_error_mps"], 1e3),
            )
        console.print(table)


def _values(estimates: Sequence[IntervalEstimate], scale: float) -> list[str]:
    return ["-" if one.value != one.value else f"{scale * one.value:.3f}" for one in estimates]


def _print_plan(
    prepared: PreparedCampaign, workers: int, plans: Sequence[RequirementPlan], as_json: bool
) -> None:
    from lidar_emu.campaign.batch import forecast

    with busy(PREPARING):
        estimate = forecast(prepared)
    if as_json:
        document = {**estimate._asdict(), "workers": workers, "hours": estimate.hours(workers)}
        if plans:
            document["requirements"] = [planned._asdict() for planned in plans]
        print_line(json.dumps(document, indent=2))
        return
    campaign = prepared.campaign
    print_line(
        f"{campaign.name}: {estimate.runs} runs of {campaign.scenario}, {campaign.sampling}, seed {campaign.seed}"
    )
    for key in campaign.drawn_keys:
        print_line(f"  {key}: {_range(prepared.drawn.columns[key])}")
    faster = estimate.flight_s / estimate.run_s
    print_line(
        f"a run takes {estimate.run_s * 1e3:.3g} ms of one core, {faster:.0f} times faster than real time"
    )
    print_line(
        f"all runs take {_duration(estimate.hours(workers))} with {workers} workers, "
        f"{_duration(estimate.hours(1))} of one core"
    )
    print_line(
        f"memory {'unknown' if estimate.process_bytes is None else _size(estimate.process_bytes)} per worker; "
        f"disk {_size(estimate.runs * estimate.run_bytes)}, {_size(estimate.run_bytes)} a run"
    )
    print_line(f"(measured: {estimate.flown} runs flown one after another in one process of this machine)")
    for planned in plans:
        print_line(str(planned))


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
