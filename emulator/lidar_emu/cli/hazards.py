"""`lidar-emu hazards`: the boulders, steps and slopes that a flight's points reveal."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.options import check_plot, load_scenario, scenario_argument, settings_option
from lidar_emu.cli.terminal import PREPARING, busy, print_line, print_note

if TYPE_CHECKING:
    from lidar_emu.numerics.arrays import FloatArray
    from lidar_emu.report.hazards import Band


@click.command(short_help="Boulders, steps and slopes detected in the points of a flight.")
@scenario_argument
@settings_option
@click.option("--plot", metavar="FILE.png|svg|pdf", help="Plot points, detection, slopes and boulders.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def hazards(scenario: str, settings: tuple[str, ...], plot: str | None, as_json: bool) -> None:
    """Fly SCENARIO, and detect in its points what stands out from the ground, and the slope of the ground.

    A point stands out if it is off the plane through its neighbours by four standard deviations; the table compares it
    with its true offset. The slope is the slope of the plane through the beams of one shot. An obstacle without a point
    on it cannot be detected: the second table states the share of boulders with a point on them.

    \b
    lidar-emu hazards hazards.yaml --plot hazards.png
    lidar-emu hazards hazards.yaml --set scanner.pattern.angle_deg=7.5 --set instrument=ndl_fine
    """
    flown = load_scenario(scenario, None, None, settings)
    from lidar_emu.report.hazards import bands_of, cloud_of, touched_shares
    from lidar_emu.scenario.load import require_flight, require_known_flight
    from lidar_emu.shots.flight_model import FlightModel

    require_known_flight(flown)
    check_plot(plot)
    with busy(PREPARING):
        cloud = cloud_of(FlightModel(require_flight(flown)))
    bands, shares = bands_of(cloud), touched_shares(cloud)
    if plot is not None:
        from lidar_emu.report.hazards import plot_hazards

        plot_hazards(cloud, bands, shares, flown.name, Path(plot))
        print_note(f"{plot}: {flown.name}")
    if as_json:
        from lidar_emu.report.hazards import BOULDERS_M, CIRCLES_M

        rows = [
            {key: None if value != value else value for key, value in vars(band).items()} for band in bands
        ]
        touched = {"circles_m": CIRCLES_M, "boulders_m": BOULDERS_M, "shares": shares.tolist()}
        print_line(json.dumps({"scenario": flown.name, "bands": rows, "touched": touched}, indent=2))
        return
    _print_bands(flown.name, bands)
    _print_shares(shares)


def _print_bands(name: str, bands: list[Band]) -> None:
    from lidar_emu.cli.plain_console import PlainConsole, plain_table

    table = plain_table(
        "altitude\nfrom\nm", "points\n\n", "spacing\n\nm", "detected\nfrom\nm", "higher\n\n", "detec-\nted\n%",
        "level\n\n", "false\nalarms\n%", "slope\nover\nm", "slope\nerror\n°", "expec-\nted\n°",
        title=name,
    )  # fmt: skip
    for band in bands:
        table.add_row(
            f"{band.low_m:.0f}",
            str(band.points),
            f"{band.spacing_m:.2g}",
            f"{band.detected_from_m:.2g}",
            str(band.higher),
            _percent(band.detected),
            str(band.level),
            _percent(band.alarms),
            "-" if math.isnan(band.slope_base_m) else f"{band.slope_base_m:.0f}",
            _number(band.slope_error_deg),
            _number(band.slope_sigma_deg),
        )
    PlainConsole().print(table)


def _print_shares(shares: FloatArray) -> None:
    from lidar_emu.cli.plain_console import PlainConsole, plain_table
    from lidar_emu.report.hazards import BOULDERS_M, CIRCLES_M

    headings = "radius, m", *(f"{diameter_m:g} m across" for diameter_m in BOULDERS_M)
    table = plain_table(*headings, title="boulders with a point, % of those within a circle")
    for circle_m, row in zip(CIRCLES_M, shares, strict=True):
        table.add_row(f"{circle_m:g}", *(f"{100 * share:.1f}" for share in row))
    PlainConsole().print(table)


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}"


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2g}"
