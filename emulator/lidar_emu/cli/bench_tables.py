"""The comparisons of `lidar-emu bench` as tables."""

from __future__ import annotations

import math

from rich import box
from rich.console import Console
from rich.table import Table

from lidar_emu.bench.accuracy import AccuracyReport, SettingResult
from lidar_emu.bench.errors_against_truth import rms
from lidar_emu.bench.settings import REFERENCE


def print_accuracy(report: AccuracyReport) -> None:
    """Settings, spectra, and what the figures rest on."""
    console = Console()
    console.print(_settings_table(report))
    console.print(_spectra_table(report))
    apart_m, apart_mps = report.twin
    console.print(
        f"{report.shots} shots. The last three columns are errors beside the reference; of settings without * "
        f"they are chance below {report.floor.range_m:.2g} m, "
        f"{1e3 * report.floor.speed_mps:.2g} mm/s and {100 * report.floor.dropout:.2g} %. "
        f"{REFERENCE.name} and spectral differ by {apart_m:.1g} m and {1e3 * apart_mps:.1g} mm/s rms "
        f"({report.pairs} beams, same speckle, noise out of the way).",
        highlight=False,
    )


def _settings_table(report: AccuracyReport) -> Table:
    title = f"{report.scenario}: settings beside {REFERENCE.name}; > on the Pareto front"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=0)
    table.add_column("setting\n", no_wrap=True)
    for heading in (
        "time\nper beam", "times\nfaster", "range\nrms m", "speed\nmm/s", "drop-\nout %", "range\nerr. m",
        "speed\nmm/s", "drop-\nout %",
    ):  # fmt: skip
        table.add_column(heading, justify="right", no_wrap=True)
    front = set(report.front)
    level = report.results[0].setting.level
    for i, result in enumerate(report.results):
        if result.setting.level != level:
            table.add_section()
            level = result.setting.level
        name = ("> " if i in front else "  ") + result.setting.name
        table.add_row(name + ("*" if result.setting.shares_draws else ""), *_cells(result))
    return table


def _cells(result: SettingResult) -> list[str]:
    spread, error = result.spread, result.error
    truth = ["-"] * 3
    if spread is not None:
        values = (
            rms(spread.range_m),
            1e3 * rms(spread.speed_mps),
            100 * spread.dropout,
        )
        truth = [_number(value) for value in values]
    return [
        _time(result.time_s),
        f"{result.waveform_ratio:.0f}",
        *truth,
        *(_number(value, 2) for value in (error.range_m, 1e3 * error.speed_mps, 100 * error.dropout)),
    ]


def _spectra_table(report: AccuracyReport) -> Table:
    table = Table(title="One segment of 61 beamlets", title_justify="left", box=box.SIMPLE_HEAD, padding=0)
    table.add_column("spectrum")
    table.add_column("  us", justify="right")
    table.add_column("  complex error over the peak", justify="right")
    for method in report.spectra:
        table.add_row(method.name, f"{1e6 * method.time_s:.3g}", f"{method.error:.1g}")
    return table


def _time(time_s: float) -> str:
    for unit, scale in (("us", 1e6), ("ms", 1e3)):
        if time_s * scale < 1000:
            return f"{time_s * scale:.3g} {unit}"
    return f"{time_s:.3g} s"


def _number(value: float, digits: int = 3) -> str:
    """At most six characters wide."""
    if not math.isfinite(value):
        return "-"
    if 0.0 < abs(value) < 1e-3:
        return f"{value:.0e}".replace("e-0", "e-")
    return f"{value:.{digits}g}"
