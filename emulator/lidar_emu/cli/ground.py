"""`lidar-emu ground`: generate, measure, plot and export ground."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lidar_emu.cli.options import load_scenario, scenario_argument, settings_option
from lidar_emu.errors import Finding, InputError

if TYPE_CHECKING:
    from lidar_emu.numerics.arrays import FloatArray
    from lidar_emu.scenario.generated_ground import Generated
    from lidar_emu.scene.generated.compare import StatisticCheck


@click.command(short_help="Generate ground; measure, plot and export it.")
@scenario_argument
@settings_option
@click.option("--plot", metavar="FILE.png", help="Plot the ground in low sun, and its statistics.")
@click.option("--out", metavar="FILE", help="Elevations as .npz, .tif (GeoTIFF) or .asc (ESRI ASCII grid).")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def ground(
    scenario: str, settings: tuple[str, ...], plot: str | None, out: str | None, as_json: bool
) -> None:
    """Generate the ground of SCENARIO's site, and compare its statistics with the requested ones.

    The ground is cached for later runs. An exported file can be used as `ground: {kind: grid, file: FILE}`, and by
    other tools.

    \b
    lidar-emu ground descent.yaml --set site=cratered --plot ground.png
    lidar-emu ground descent.yaml --set site=cratered --set site.ground.seed=7 --out seed7.tif
    lidar-emu ground my.yaml --json
    """
    _check_paths(plot, out)
    specified = _generated(scenario, settings)
    import numpy as np

    from lidar_emu.scene.generated.cache import keep
    from lidar_emu.scene.generated.compare import compare
    from lidar_emu.scene.generated.generate import generate

    layers = generate(specified)
    elevation_m = layers.elevation_m(specified)
    kept = keep(specified, elevation_m)
    found = compare(specified, layers)
    whole = _whole(specified, elevation_m.astype(np.float64))
    if out is not None:
        from lidar_emu.report.ground_export import export_ground

        export_ground(specified, elevation_m, Path(out))
    if plot is not None:
        from lidar_emu.report.ground_plot import plot_ground

        plot_ground(specified, layers, found, _title(specified), Path(plot))
    if as_json:
        document = {
            "ground": specified.model_dump(),
            "kept_in": None if kept is None else str(kept),
            "whole_ground": whole,
            "statistics": [{**vars(row), "within": row.within} for row in found],
        }
        click.echo(json.dumps(document, indent=2))
        return
    _print(specified, found, whole)
    for path in (out, plot):
        if path is not None:
            click.echo(path)


def _check_paths(plot: str | None, out: str | None) -> None:
    if plot is not None:
        from lidar_emu.report.png_file import check_plot_path

        check_plot_path(Path(plot))
    if out is not None:
        from lidar_emu.report.ground_export import check_ground_path

        check_ground_path(Path(out))


def _generated(scenario: str, settings: tuple[str, ...]) -> Generated:
    flown = load_scenario(scenario, None, None, settings)
    from lidar_emu.scenario.generated_ground import Generated
    from lidar_emu.scenario.schema import FlightScenario

    if not isinstance(flown, FlightScenario):
        raise InputError(scenario, None, Finding("a bench pattern"), "allowed: a flight, with a site")
    if not isinstance(flown.site.ground, Generated):
        allowed = "allowed: generated, as in --set site=cratered"
        raise InputError(scenario, "site.ground.kind", flown.site.ground.kind, allowed)
    return flown.site.ground


def _title(specified: Generated) -> str:
    return f"generated ground, {specified.size_m:g} m, a sample every {specified.spacing_m:g} m, seed {specified.seed}"


def _whole(specified: Generated, elevation_m: FloatArray) -> dict[str, Any]:
    """Height range and slopes of the whole ground, to which relief, craters and rocks all contribute."""
    import numpy as np

    from lidar_emu.scene.generated.statistics import doubling_lags, structure_function

    lags = doubling_lags(len(elevation_m), 1 / 8)
    distance_m = lags * specified.spacing_m
    slope_deg = np.degrees(np.arctan(np.sqrt(structure_function(elevation_m, lags)) / distance_m))
    return {
        "lowest_m": float(elevation_m.min()),
        "highest_m": float(elevation_m.max()),
        "rms_slope": [
            {"baseline_m": baseline_m, "slope_deg": slope}
            for baseline_m, slope in zip(distance_m.tolist(), slope_deg.tolist(), strict=True)
        ],
    }


def _print(specified: Generated, found: list[StatisticCheck], whole: dict[str, Any]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(title=_title(specified), title_justify="left", box=box.SIMPLE_HEAD, padding=0)
    table.add_column("statistic")
    for heading in ("requested", "found", "from", "to"):
        table.add_column(heading, justify="right")
    table.add_column("")
    for row in found:
        numbers = (f"{value:.4g}" for value in (row.asked, row.found, row.low, row.high))
        table.add_row(row.quantity, *numbers, "" if row.within else "outside")
    console = Console()
    console.print(table)
    slopes = ", ".join(f"{row['slope_deg']:.3g}° over {row['baseline_m']:g} m" for row in whole["rms_slope"])
    console.print(
        f"The whole ground lies between {whole['lowest_m']:.1f} and {whole['highest_m']:.1f} m; rms slope {slopes}.",
        highlight=False,
    )
