"""`lidar-emu bench`: what the emulator's accuracy costs, and how fast and punctual it is on this machine."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.bench_campaign import campaign
from lidar_emu.cli.bench_casting import casting
from lidar_emu.cli.bench_protocol import protocol
from lidar_emu.cli.bench_realtime import realtime
from lidar_emu.cli.bench_response import response
from lidar_emu.cli.options import as_number, load_scenario, settings_option
from lidar_emu.errors import Finding, InputError, RunError

if TYPE_CHECKING:
    from lidar_emu.bench.accuracy import AccuracyReport, SettingResult


@click.group(short_help="How exact, how fast and how punctual the emulator is, measured by itself.")
def bench() -> None:
    """Measure the emulator itself, on this machine."""


bench.add_command(campaign)
bench.add_command(casting)
bench.add_command(protocol)
bench.add_command(realtime)
bench.add_command(response)


@bench.command(short_help="Error and time of every level and dial, beside the waveform level.")
@click.argument("scenario", default="descent.yaml")
@settings_option
@click.option("--shots", metavar="N", default="1000", show_default=True,
              help="Shots at each fast setting, spread over the flight; beyond its end, with other seeds.")  # fmt: skip
@click.option(
    "--target-range-error", metavar="M", help="Name the cheapest setting this near to the reference."
)
@click.option("--target-speed-error", metavar="MPS", help="The same for closing speed.")
@click.option("--plot", metavar="FILE.png", help="Picture: error over time, with the Pareto front.")
@click.option("--json", "as_json", is_flag=True, help="For machines.")
def accuracy(
    scenario: str,
    settings: tuple[str, ...],
    shots: str,
    target_range_error: str | None,
    target_speed_error: str | None,
    plot: str | None,
    as_json: bool,
) -> None:
    """Compare levels and dials on SCENARIO (descent.yaml): error, dropouts, and time per beam measurement.

    The reference is level waveform with 127 beamlets. A setting's error is the root mean square difference between the
    quantiles (1 % to 99 %) of its errors against the truth and those of the reference. docs/accuracy.md explains how.
    Takes about a minute, and more by --shots.

    \b
    lidar-emu bench accuracy
    lidar-emu bench accuracy descent.yaml --plot accuracy.png
    lidar-emu bench accuracy my.yaml --target-range-error 0.01 --target-speed-error 1e-4
    lidar-emu bench accuracy --set instrument=ndl_fine --shots 4000 --json
    """
    count = _count(shots)
    range_m, speed_mps = (
        None if text is None else as_number(option, text)
        for option, text in (
            ("--target-range-error", target_range_error),
            ("--target-speed-error", target_speed_error),
        )
    )
    if plot is not None:
        from lidar_emu.report.work_precision_plot import check_plot_path

        check_plot_path(Path(plot))
    flown = load_scenario(scenario, None, None, settings)
    from lidar_emu.scenario.schema import FlightScenario

    if not isinstance(flown, FlightScenario):
        allowed = "allowed: a flight, with an instrument and a site"
        raise InputError(scenario, None, Finding("a bench pattern"), allowed)
    from lidar_emu.bench.accuracy import measure_accuracy

    report = measure_accuracy(flown, count, _show)
    targeted = range_m is not None or speed_mps is not None
    chosen = None
    if targeted:
        bounds = (math.inf if bound is None else bound for bound in (range_m, speed_mps))
        chosen = report.cheapest(*bounds)
    if plot is not None:
        _plot(report, Path(plot))
    if as_json:
        from lidar_emu.bench.document import document

        click.echo(json.dumps(document(report) | {"cheapest": chosen and chosen.setting.name}, indent=2))
    else:
        from lidar_emu.cli.bench_tables import print_accuracy

        print_accuracy(report)
    if targeted:
        _conclude(chosen, as_json)


def _conclude(chosen: SettingResult | None, as_json: bool) -> None:
    if chosen is None:
        raise RunError(
            "no setting is as near to the reference as asked for; more --shots tell smaller errors from chance"
        )
    if not as_json:
        setting = chosen.setting
        keys = f"--set level={setting.level} --set instrument.optics.beamlets={setting.beamlets}"
        keys += f" --set exact={str(setting.exact).lower()}" if setting.level == "spectral" else ""
        click.echo(f"cheapest: {setting.name}, {chosen.time_s * 1e6:.3g} us per beam measurement: {keys}")


def _plot(report: AccuracyReport, path: Path) -> None:
    from lidar_emu.bench.document import marks
    from lidar_emu.report.work_precision_plot import plot_work_precision

    range_marks, speed_marks = marks(report)
    panels = [
        ("range error beside the reference (m)", range_marks, report.floor.range_m),
        ("speed error beside the reference (m/s)", speed_marks, report.floor.speed_mps),
    ]
    plot_work_precision(panels, f"{report.scenario}: what accuracy costs", path)
    click.echo(f"{path}: {report.scenario}", err=True)


def _show(what: str) -> None:
    """Progress, where somebody looks."""
    if sys.stderr is not None and sys.stderr.isatty():
        click.echo(f"... {what}", err=True)


def _count(text: str) -> int:
    try:
        count = int(text)
    except ValueError:
        count = 0
    if not 10 <= count <= 1_000_000:
        raise InputError("--shots", None, text, "allowed: a whole number from 10 to 1000000")
    return count
