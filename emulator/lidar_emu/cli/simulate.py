"""`lidar-emu simulate`: the measurements of a run, without link and clock."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.options import check_plot, geometry_option, load_scenario, plot_option, scenario_options
from lidar_emu.cli.terminal import PREPARING, busy, print_line
from lidar_emu.errors import Finding, InputError
from lidar_emu.files import check_destination, check_keeps

if TYPE_CHECKING:
    from lidar_emu.measurement import Measurement
    from lidar_emu.scenario.schema import BenchScenario, FlightScenario


@click.command(short_help="Compute the measurements without a link: table, point cloud or plot.")
@scenario_options
@click.option("--out", metavar="FILE", help="Table or point cloud: .csv, .npz, .parquet or .ply.")
@plot_option("the descent: path, footprints, errors")
@click.option("--geometry-out", metavar="FILE.npz", help="Record where the beams point and what they hit.")
@geometry_option
def simulate(
    scenario: str,
    duration: str | None,
    seed: str | None,
    settings: tuple[str, ...],
    exact: bool,
    out: str | None,
    plot: tuple[str, ...],
    geometry_out: str | None,
    geometry: str | None,
) -> None:
    """Measure SCENARIO without a link: the same values as `run` for the same seed.

    \b
    lidar-emu simulate descent.yaml --out descent.csv
    lidar-emu simulate paper_fig5.yaml --plot fig5.png
    lidar-emu simulate descent.yaml --out points.ply --set timing.rate_hz=200
    lidar-emu simulate descent.yaml --geometry-out flight.npz
    lidar-emu simulate descent.yaml --geometry flight.npz --set instrument.optics.laser_power_w=0.5 --out half.csv
    """
    from lidar_emu.report.exports import check_export_path, export

    if out is None and not plot and geometry_out is None:
        remedy = "pass --out FILE, --plot FILE.png or --geometry-out FILE.npz"
        raise InputError("simulate", None, Finding("no output"), remedy)
    if geometry_out is not None and geometry is not None:
        remedy = "pass --geometry-out to record, or --geometry to measure a recorded geometry"
        raise InputError("simulate", None, Finding("both geometries"), remedy)
    if geometry_out is not None:
        check_destination(Path(geometry_out), "--geometry-out", [".npz"])
        if geometry_out == out:
            raise InputError("--out", None, out, "must be another file than the geometry")
    if out is not None:
        check_export_path(Path(out))
        check_keeps(Path(geometry or scenario), Path(out), "--out")
    check_plot(plot)
    flown = load_scenario(scenario, duration, seed, settings, exact)
    from lidar_emu.runtime.clock import Clock
    from lidar_emu.scenario.load import check_keeps_files, require_known_flight
    from lidar_emu.shots.model import build_model, measure_in_blocks, measure_whole

    require_known_flight(flown)
    check_keeps_files(flown, {"--out": [out], "--plot": plot, "--geometry-out": [geometry_out]})
    if geometry_out is not None:
        _record(flown, Path(geometry_out))
        geometry = geometry_out  # the receiver measures the recorded geometry
    if out is None and not plot:
        return
    with busy(PREPARING):
        model = build_model(flown, None if geometry is None else Path(geometry))
        now_ns = Clock().now_ns
        blocks: Iterable[Measurement] = measure_in_blocks(model, now_ns=now_ns)
        # The plot first: if it has nothing to draw, no file must be left. It needs all shots at once.
        if plot:
            from lidar_emu.report.descent_plot import plot_descent
            from lidar_emu.scenario.schema import FlightScenario

            measurement = measure_whole(model, now_ns)
            scene = None if model.flight is None else model.flight.scene
            objects = flown.site.objects if isinstance(flown, FlightScenario) else []
            moving = {number: each.name for number, each in enumerate(objects, 1) if each.motion is not None}
            for path in plot:
                plot_descent(measurement, scene, flown.name, Path(path), flown.faults, moving)
            blocks = [measurement]
        if out is not None:
            export(blocks, Path(out))
    for path in plot:
        print_line(f"{path}: {flown.name}")
    if out is not None:
        print_line(f"{out}: {model.shot_count} shots of {model.beam_count} beams")


def _record(flown: FlightScenario | BenchScenario, path: Path) -> None:
    from lidar_emu.report.geometry_export import record_geometry
    from lidar_emu.scenario.load import require_flight

    with busy(PREPARING):
        about = record_geometry(require_flight(flown), path)
    size = path.stat().st_size
    each = f"{about.beams} beams, {about.beamlets} rays each"
    print_line(
        f"{path}: {about.shots} shots of {each}; {size / 1e6:.1f} MB, {size / about.shots / 1e3:.1f} kB a shot"
    )
