"""`lidar-emu simulate`: the measurements of a run, without wire and clock."""

from __future__ import annotations

from pathlib import Path

import click

from lidar_emu.cli.options import load_scenario, scenario_options
from lidar_emu.cli.progress import COMPILING, busy
from lidar_emu.errors import Finding, InputError


@click.command(short_help="The same measurements as a table, point cloud or picture.")
@scenario_options
@click.option("--out", metavar="FILE", help="Table or point cloud: .csv, .npz, .parquet or .ply.")
@click.option("--plot", metavar="FILE.png", help="Picture of the descent: path, footprints, errors.")
def simulate(
    scenario: str,
    duration: str | None,
    seed: str | None,
    settings: tuple[str, ...],
    exact: bool,
    out: str | None,
    plot: str | None,
) -> None:
    """Measure SCENARIO without a wire: for the same seed the same values as `run`.

    \b
    lidar-emu simulate descent.yaml --out descent.csv
    lidar-emu simulate paper_fig5.yaml --plot fig5.png
    lidar-emu simulate descent.yaml --out points.ply --set timing.rate_hz=200
    """
    from lidar_emu.report.exports import check_export_path, export

    if out is None and plot is None:
        raise InputError(
            "simulate", None, Finding("no output"), "allowed: --out FILE, --plot FILE.png or both"
        )
    if out is not None:
        check_export_path(Path(out))
    if plot is not None:
        from lidar_emu.report.descent_plot import check_plot_path, plot_descent

        check_plot_path(Path(plot))
    flown = load_scenario(scenario, duration, seed, settings, exact)
    from lidar_emu.shots import FlightModel, build_model, measure_whole, require_known_flight

    require_known_flight(flown)
    with busy(COMPILING):
        model = build_model(flown)
        measurement = measure_whole(model)
    # The picture first: it may find nothing to draw, and then no file must be left.
    if plot is not None:
        scene = model.flight.scene if isinstance(model, FlightModel) else None
        plot_descent(measurement, scene, flown.name, Path(plot))
        click.echo(f"{plot}: {flown.name}")
    if out is not None:
        export(measurement, Path(out))
        click.echo(f"{out}: {len(measurement)} shots of {measurement.beam_count} beams")
