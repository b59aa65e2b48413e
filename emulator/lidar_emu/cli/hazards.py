"""`lidar-emu hazards`: hazard detection by a flight's points, and the map of where a lander stands safely."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lidar_emu.cli.options import (
    as_whole,
    check_plot,
    load_scenario,
    plot_option,
    scenario_argument,
    settings_option,
)
from lidar_emu.cli.terminal import PREPARING, busy, print_line, print_note
from lidar_emu.errors import InputError

if TYPE_CHECKING:
    from lidar_emu.numerics.arrays import FloatArray
    from lidar_emu.report.ground_survey import GroundSurvey
    from lidar_emu.report.hazard_map import HazardMap, Lander
    from lidar_emu.report.hazard_regions import DetectionRow, DetectionTally
    from lidar_emu.report.hazards import Cloud
    from lidar_emu.scenario.schema import FlightScenario


@click.command(short_help="Hazard detection in the points of a flight, and a map of it.")
@scenario_argument
@settings_option
@click.option(
    "--map",
    "map_file",
    metavar="FILE.tif|npz",
    help="Height, slope, roughness, safe probability in 0.5 m cells.",
)
@click.option(
    "--lander",
    metavar="DIAMETER,SLOPE,STEP",
    default="10,10,0.3",
    show_default=True,
    help="Width of the landing area in m; largest slope in degrees and step in m in it.",
)
@plot_option("hazards, points, safe probability and detection")
@click.option(
    "--flights", metavar="N", default="1", show_default=True,
    help="Count over N flights, each with other seeds of noise and of a generated ground.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def hazards(
    scenario: str,
    settings: tuple[str, ...],
    map_file: str | None,
    lander: str,
    plot: tuple[str, ...],
    flights: str,
    as_json: bool,
) -> None:
    """Fly SCENARIO, and detect hazards in its points: boulders, craters and steps that stand out from the ground.

    A point is detected as a hazard if it is off the plane through its neighbours by four standard deviations and by
    more than STEP. The first table states the probability of detection of the features near the landing place, by
    height from half of STEP, and the probability of a false alarm.

    The map has slope and roughness of the landing area about each cell, and the probability that both are within the
    lander's limits. The second table states how often they are. docs/hazards.md explains it.

    \b
    lidar-emu hazards hazards.yaml --set scanner.pattern.angle_deg=7.5 --set instrument=ndl_fine
    lidar-emu hazards hazard_scan.yaml --plot hazards.png --map hazards.tif
    lidar-emu hazards hazard_scan.yaml --lander 6,15,0.5 --flights 20 --json
    """
    flown = load_scenario(scenario, None, None, settings)
    from lidar_emu.report.ground_survey import check_raster_path
    from lidar_emu.report.hazard_map import MAP_SUFFIXES, Lander, write_map
    from lidar_emu.report.hazard_regions import by_height, total
    from lidar_emu.scenario.load import check_keeps_files, require_flight, require_known_flight

    limits, count = Lander(*_limits(lander)), as_whole("--flights", flights)
    flight = require_flight(require_known_flight(flown))
    check_plot(plot)
    if map_file is not None:
        check_raster_path(Path(map_file), MAP_SUFFIXES)
    check_keeps_files(flight, {"--map": [map_file], "--plot": plot})
    with busy(PREPARING):
        cloud, found, truth, slope_deg, first = _fly(flight, limits)
    tallies = [first]
    for number in range(1, count):
        with busy(f"flight {number + 1} of {count}"):
            tallies.append(_fly(_reseeded(flight, scenario, settings, number), limits)[-1])
    tally = total(tallies)
    rows = by_height(tally.hazards, limits.step_m)
    if map_file is not None:
        write_map(found, Path(map_file))
        print_note(f"{map_file}: {flown.name}")
    for path in plot:
        from lidar_emu.report.hazard_plots import draw_hazards
        from lidar_emu.report.plot_style import write_plot

        title = f"hazard detection in {flown.name}: {flight.instrument.name} over {flight.site.name}"
        write_plot(draw_hazards(cloud, found, truth, slope_deg, first, tally, title), Path(path))
        print_note(f"{path}: {flown.name}")
    if as_json:
        print_line(json.dumps(_document(flown.name, rows, tally), indent=2))
        return
    _print_detection(flown.name, rows, tally, count)
    _print_reliability(flown.name, tally)


def _reseeded(flown: FlightScenario, scenario: str, settings: tuple[str, ...], number: int) -> FlightScenario:
    """Read a flight again, with other seeds of noise and of a generated ground."""
    from lidar_emu.scenario.ground import Generated
    from lidar_emu.scenario.load import require_flight

    seeds = [f"seed={flown.seed + number}"]
    if isinstance(flown.site.ground, Generated):
        seeds.append(f"site.ground.seed={flown.site.ground.seed + number}")
    return require_flight(load_scenario(scenario, None, None, (*settings, *seeds)))


def _fly(
    flown: FlightScenario, limits: Lander
) -> tuple[Cloud, HazardMap, GroundSurvey, FloatArray, DetectionTally]:
    """Fly, map the hazards, and compare them with the truth."""
    from lidar_emu.report.hazard_map import map_hazards
    from lidar_emu.report.hazard_regions import verify
    from lidar_emu.report.hazards import cloud_of
    from lidar_emu.scene import build_scene
    from lidar_emu.shots.flight_model import FlightModel

    cloud = cloud_of(FlightModel(flown))
    found = map_hazards(cloud, limits)
    tally, truth, slope_deg = verify(cloud, found, build_scene(flown.site))
    return cloud, found, truth, slope_deg, tally


def _limits(text: str) -> list[float]:
    try:
        diameter_m, slope_deg, step_m = (float(number) for number in text.split(","))
    except ValueError:
        diameter_m = slope_deg = step_m = math.nan
    if not (2.0 <= diameter_m <= 50.0 and 0.0 < slope_deg < 90.0 and 0.0 < step_m <= 10.0):
        remedy = "must be DIAMETER,SLOPE,STEP: 2 to 50 m, below 90 degrees, up to 10 m, e.g. 10,10,0.3"
        raise InputError("--lander", None, text, remedy)
    return [diameter_m, slope_deg, step_m]


def _document(name: str, rows: list[DetectionRow], tally: DetectionTally) -> dict[str, Any]:
    from lidar_emu.report.hazard_regions import by_probability

    return {
        "scenario": name,
        "detection": [{**row._asdict(), "interval": row.interval} for row in rows],
        "false_alarms": {"points": tally.level, "alarms": tally.alarms, "interval": tally.alarm_interval},
        "reliability": [row._asdict() for row in by_probability(tally)],
    }


def _print_detection(name: str, rows: list[DetectionRow], tally: DetectionTally, flights: int) -> None:
    from lidar_emu.cli.plain_console import PlainConsole, plain_table
    from lidar_emu.report.hazard_regions import CONFIDENCE

    headings = (
        "height\nfrom, m",
        "\nfeatures",
        "with a\npoint",
        "\ndetected",
        "\n%",
        f"{CONFIDENCE:.0%}\nfrom",
        "\nto",
    )
    table = plain_table(*headings, title=f"{name}: detection, {flights} flight(s)")
    for row in rows:
        share = row.detected / row.hazards if row.hazards else None
        numbers = (str(number) for number in (row.hazards, row.touched, row.detected))
        table.add_row(f"{row.low_m:.2f}", *numbers, _percent(share), *(_percent(end) for end in row.interval))
    PlainConsole().print(table)
    low, high = tally.alarm_interval
    print_line(
        f"false alarms: {tally.alarms} of {tally.level} points off features, "
        f"probability {100 * low:.2g} to {100 * high:.2g} %"
    )


def _print_reliability(name: str, tally: DetectionTally) -> None:
    from lidar_emu.cli.plain_console import PlainConsole, plain_table
    from lidar_emu.report.hazard_regions import by_probability

    headings = "safe probability", "landing areas", "of these safe, %"
    table = plain_table(*headings, title=f"{name}: reliability")
    for row in by_probability(tally):
        table.add_row(f"{row.stated:.2f}", str(row.landing_areas), _percent(row.safe))
    PlainConsole().print(table)


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}"
