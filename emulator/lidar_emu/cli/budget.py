"""`lidar-emu budget`: the uncertainty of one measurement by source."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.options import load_scenario, scenario_argument, settings_option
from lidar_emu.cli.terminal import busy, print_line
from lidar_emu.errors import InputError

if TYPE_CHECKING:
    from lidar_emu.plan.uncertainty import Combined, Contribution, Sheet, Source


@click.command(short_help="Uncertainty of one measurement by source, as GUM writes it.")
@scenario_argument
@settings_option
@click.option(
    "--at", "altitude", metavar="ALTITUDE", required=True, help="Metres above the points that beams hit."
)
@click.option("--beam", metavar="N", default="0", show_default=True, help="Number of the beam, from 0.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def budget(scenario: str, settings: tuple[str, ...], altitude: str, beam: str, as_json: bool) -> None:
    """List what makes one range and one closing speed of SCENARIO uncertain at an altitude.

    Per source: the input's standard uncertainty, its distribution, and the sensitivity and contribution of range and
    closing speed. Sources that the scenario lacks are in brackets, with a typical size. All that it has are combined by
    100 000 draws: the sheet ends with half-widths at 68.27 and 95 %, and their coverage factor. Faults are left out.

    \b
    lidar-emu budget descent.yaml --at 500
    lidar-emu budget descent.yaml --at 100 --set instrument=ndl_fine --beam 2
    lidar-emu budget my.yaml --at 50 --json
    """
    altitude_m, number = _number("--at", altitude), _number("--beam", beam)
    if number != int(number):
        raise InputError("--beam", None, beam, "must be a whole number")
    from lidar_emu.scenario.load import require_flight, require_known_flight

    loaded = load_scenario(scenario, None, None, settings)
    require_known_flight(loaded)
    flown = require_flight(loaded)
    from lidar_emu.plan.uncertainty import uncertainty_at

    with busy(f"drawing errors of {flown.name}"):
        sheet = uncertainty_at(flown, altitude_m, int(number))
    if as_json:
        print_line(
            json.dumps(
                {"scenario": flown.name, "instrument": flown.instrument.name} | asdict(sheet), indent=2
            )
        )
    else:
        _print(flown.name, sheet)


def _number(option: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0.0):
        raise InputError(option, None, text, "must be a number, 0 or above")
    return value


def _print(name: str, sheet: Sheet) -> None:
    from lidar_emu.cli.plain_console import PlainConsole, plain_table

    title = (
        f"beam {sheet.beam} of {name} at {sheet.time_s:.2f} s, {sheet.altitude_m:.5g} m: range {sheet.range_m:.6g} m, "
        f"closing speed {sheet.closing_speed_mps:.5g} m/s, incidence {sheet.incidence_deg:.3g}°, "
        f"SNR {sheet.snr_db:.1f} dB, valid {100.0 * sheet.detected:.3g} %"
    )
    table = plain_table(
        "source", "input", "distribution", "u(input)", "c of\nrange", "u, m", "95 %\nm", "c of\nspeed", "u, mm/s",
        "95 %\nmm/s", title=title, texts=3,
    )  # fmt: skip
    for source in sheet.sources:
        table.add_row(*_cells(source))
    console = PlainConsole()
    console.print(table)
    for quantity, unit, scale, error in (
        ("range", "m", 1.0, sheet.range_error_m),
        ("speed", "mm/s", 1e3, sheet.speed_error_mps),
    ):
        print_line(_line(quantity, unit, scale, error))
    print_line(
        "(source): off, with the values of a typical size. u of a Student t is its 68.27 % half-width."
    )


def _cells(source: Source) -> tuple[str, ...]:
    name = source.name if source.on else f"({source.name})"
    quantity = f"{source.quantity}, {source.unit}" if source.unit else source.quantity
    parts = *_values(source.range_m, 1.0), *_values(source.speed_mps, 1e3)
    return name, quantity, source.law, f"{source.input_uncertainty:.3g}", *parts


def _values(part: Contribution, scale: float) -> tuple[str, str, str]:
    return f"{part.sensitivity:.3g}", f"{scale * part.uncertainty:.3g}", f"{scale * part.half_width_95:.3g}"


def _line(quantity: str, unit: str, scale: float, error: Combined) -> str:
    return (
        f"{quantity}: systematic {scale * error.systematic:+.3g} {unit}; beside it ±{scale * error.half_width_68:.3g} "
        f"(68.27 %), ±{scale * error.half_width_95:.3g} (95 %, k = {error.coverage_factor_95:.2f}); with it "
        f"±{scale * error.reported_68:.3g}, ±{scale * error.reported_95:.3g}"
    )
