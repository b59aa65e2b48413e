"""`lidar-emu bench`: its group, and `bench accuracy`, error against computing time of every level."""

from __future__ import annotations

import json
import math
from dataclasses import astuple
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.bench_latency import realtime, response
from lidar_emu.cli.bench_stability import stability
from lidar_emu.cli.options import as_number, as_whole, check_plot, load_scenario, plot_option, settings_option
from lidar_emu.cli.terminal import print_line, print_note, show_step
from lidar_emu.errors import InputError, RunError

if TYPE_CHECKING:
    from rich.table import Table

    from lidar_emu.bench.accuracy import AccuracyReport, SettingResult


@click.command(short_help="Error and time of every level and setting, relative to scatterers.")
@click.argument("scenario", default="descent.yaml")
@settings_option
@click.option("--shots", metavar="N", default="1000", show_default=True,
              help="Shots at each fast setting, spread over the flight; any excess with other seeds.")  # fmt: skip
@click.option(
    "--target-range-error", metavar="M", help="Name the cheapest setting within this error of the reference."
)
@click.option("--target-speed-error", metavar="MPS", help="The same for closing speed.")
@click.option(
    "--target-dropout", metavar="SHARE", help="The same for the shares of dropouts and false locks."
)
@plot_option("error against time, with the Pareto front")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def accuracy(
    scenario: str,
    settings: tuple[str, ...],
    shots: str,
    target_range_error: str | None,
    target_speed_error: str | None,
    target_dropout: str | None,
    plot: tuple[str, ...],
    as_json: bool,
) -> None:
    """Compare levels and settings on SCENARIO (descent.yaml): error, dropouts, and time per beam measurement.

    The reference is the light of scatterers (level reference), on a quarter of the shots. A setting's errors are the
    root mean square difference between the quantiles (1 % to 99 %) of its errors against the ground truth and the
    reference's quantiles, and the difference of the shares of dropouts and false locks; see docs/accuracy.md.
    Takes some minutes with the default --shots.

    \b
    lidar-emu bench accuracy
    lidar-emu bench accuracy descent.yaml --plot accuracy.png
    lidar-emu bench accuracy my.yaml --target-range-error 0.01 --target-speed-error 1e-4 --target-dropout 0.01
    lidar-emu bench accuracy --set instrument=ndl_fine --shots 4000 --json
    """
    count = as_whole("--shots", shots, 10, 1_000_000)
    bounds = [
        math.inf if text is None else as_number(option, text)
        for option, text in (
            ("--target-range-error", target_range_error),
            ("--target-speed-error", target_speed_error),
            ("--target-dropout", target_dropout),
        )
    ]
    if 1.0 < bounds[2] < math.inf:
        raise InputError("--target-dropout", None, target_dropout, "must be a share, at most 1")
    check_plot(plot)
    from lidar_emu.scenario.load import require_flight

    flown = require_flight(load_scenario(scenario, None, None, settings))
    from lidar_emu.bench.accuracy import measure_accuracy
    from lidar_emu.bench.settings import DistributionDifference

    report = measure_accuracy(flown, count, show_step)
    show_step("")
    targeted = min(bounds) < math.inf
    chosen = report.cheapest(DistributionDifference(*bounds)) if targeted else None
    for path in plot:
        _plot(report, Path(path))
    if as_json:
        from lidar_emu.bench.accuracy import document

        print_line(json.dumps(document(report) | {"cheapest": chosen and chosen.setting.name}, indent=2))
    else:
        _print(report)
    if targeted:
        _conclude(chosen, as_json)


def _conclude(chosen: SettingResult | None, as_json: bool) -> None:
    if chosen is None:
        raise RunError(
            "no setting is within the requested error of the reference; more --shots resolve smaller errors"
        )
    if not as_json:
        setting = chosen.setting
        keys = f"--set level={setting.level} --set instrument.optics.beamlets={setting.beamlets}"
        keys += " --set left_out_share=0" if setting.level == "spectral" and setting.exact else ""
        print_line(f"cheapest: {setting.name}, {chosen.time_s * 1e6:.3g} us per beam measurement: {keys}")


def _plot(report: AccuracyReport, path: Path) -> None:
    from lidar_emu.bench.accuracy import marks
    from lidar_emu.report.statistics_plots import plot_work_precision

    axes = (
        ("range error (m)", 1.0),
        ("closing speed error (mm/s)", 1e3),
        ("share of dropouts, false locks (%)", 100.0),
    )
    panels = [
        (name, [mark._replace(error=scale * mark.error) for mark in marked], scale * floor)
        for (name, scale), marked, floor in zip(axes, marks(report), astuple(report.floor), strict=True)
    ]
    plot_work_precision(panels, f"{report.scenario}: error of each level against its computing time", path)
    print_note(f"{path}: {report.scenario}")


def _print(report: AccuracyReport) -> None:
    from lidar_emu.cli.plain_console import PlainConsole

    console = PlainConsole()
    console.print(_settings_table(report))
    console.print(
        f"{report.shots} shots, {report.reference_shots} of the reference; shares in %. The last three columns are "
        f"errors relative to the reference; they are sampling noise below {report.floor.range_m:.2g} m, "
        f"{1e3 * report.floor.speed_mps:.2g} mm/s and {100 * report.floor.outcome:.2g} %."
    )


def _settings_table(report: AccuracyReport) -> Table:
    from rich import box
    from rich.table import Table

    from lidar_emu.bench.settings import REFERENCE

    title = f"{report.scenario}: settings relative to {REFERENCE.name}; > on the Pareto front of range"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=0, show_edge=False)
    table.add_column("setting\n", no_wrap=True)
    for heading in (
        "time\na beam", "speed\n-up", "range\nrms m", "speed\nmm/s", "drop-\nout %", "false\nlocks",
        "range\nerr. m", "speed\nmm/s", "drop,\nfalse",
    ):  # fmt: skip
        table.add_column(heading, justify="right", no_wrap=True)
    front = set(report.front)
    level = report.results[0].setting.level
    for i, result in enumerate(report.results):
        if result.setting.level != level:
            table.add_section()
            level = result.setting.level
        name = (">" if i in front else " ") + result.setting.name
        table.add_row(name, *_cells(report, result))
    return table


def _cells(report: AccuracyReport, result: SettingResult) -> list[str]:
    from lidar_emu.bench.settings import rms

    spread, error = result.spread, result.error
    truth_errors = rms(spread.range_m), 1e3 * rms(spread.speed_mps)
    against_truth = *truth_errors, 100 * spread.dropout, 100 * spread.false_lock
    ratio = report.times_faster(result)
    against_reference = error.range_m, 1e3 * error.speed_mps, 100 * error.outcome
    return [
        _time(result.time_s),
        f"{ratio:.0f}" if ratio < 1000 else f"{ratio / 1000:.0f}k",
        *(_number(value) for value in against_truth),
        *(_number(value, 2) for value in against_reference),
    ]


def _time(time_s: float) -> str:
    for unit, scale in (("us", 1e6), ("ms", 1e3)):
        if time_s * scale < 1000:
            return f"{time_s * scale:.3g} {unit}"
    return f"{time_s:.3g} s"


def _number(value: float, digits: int = 3) -> str:
    """Format a number in at most six characters."""
    if not math.isfinite(value):
        return "-"
    if 0.0 < abs(value) < 1e-3:
        return f"{value:.0e}".replace("e-0", "e-")
    return f"{value:.{digits}g}"


@click.group(short_help="Measure the emulator's accuracy, speed and timing on this machine.")
def bench() -> None:
    """Measure the emulator itself, on this machine."""


for command in (accuracy, realtime, response, stability):
    bench.add_command(command)
