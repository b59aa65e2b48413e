"""`lidar-emu budget`: the uncertainty of one measurement by source."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.options import load_scenario, number_in, scenario_argument, settings_option
from lidar_emu.cli.terminal import busy, print_line
from lidar_emu.errors import InputError

if TYPE_CHECKING:
    from lidar_emu.plan.uncertainty import Sheet, UncertaintySource

_ROUNDING = 1e-9


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

    Per source: type, distribution and standard uncertainty of the input, and for range and closing speed the
    sensitivity c and the contribution u. Sources that the scenario lacks are in brackets, with a typical size. All that
    it has are combined by 100 000 draws to half-widths U of 68.27 and 95 %, with coverage factors k. Speckle, and noise
    in it, have no variance: their u is the half-width of 68.27 %. Faults are left out.

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
    flown = require_flight(require_known_flight(loaded))
    from lidar_emu.plan.uncertainty import uncertainty_at

    with busy(f"drawing errors of {flown.name}"):
        sheet = uncertainty_at(flown, altitude_m, int(number))
    if as_json:
        about = {"scenario": flown.name, "instrument": flown.instrument.name}
        print_line(json.dumps(about | asdict(sheet), indent=2))
    else:
        _print(flown.name, sheet)


def _number(option: str, text: str) -> float:
    value = number_in(text)
    if not (math.isfinite(value) and value >= 0.0):
        raise InputError(option, None, text, "must be a number, 0 or above")
    return value


def _print(name: str, sheet: Sheet) -> None:
    from lidar_emu.cli.plain_console import PlainConsole, plain_table

    console = PlainConsole()
    console.print(
        f"beam {sheet.beam} of {name} at {sheet.time_s:.2f} s, {sheet.altitude_m:.5g} m: range "
        f"{sheet.range_m:.6g} m, closing speed {sheet.closing_speed_mps:.5g} m/s, incidence "
        f"{sheet.incidence_deg:.3g}°, SNR {sheet.snr_db:.1f} dB, valid {100.0 * sheet.detected:.3g} %"
    )
    table = plain_table(
        "source", "type", "law", "u(input)", "range:\nc", "\nu, mm", "speed:\nc", "\nu, mm/s", texts=3
    )
    for source in sheet.sources:
        table.add_row(*_cells(source))
    console.print(table)
    combined = plain_table(
        *("error", "u", "U\n68.27 %", "k", "U\n95 %", "k", "syste-\nmatic", "with it\n68.27 %", "\n95 %"),
        texts=1,
    )
    for quantity, error in (("range, mm", sheet.range_error_m), ("speed, mm/s", sheet.speed_error_mps)):
        sizes = {key: _digits(3, 1e3 * value) for key, value in asdict(error).items()}
        factors = f"{error.coverage_factor_68:.2f}", f"{error.coverage_factor_95:.2f}"
        combined.add_row(
            quantity, sizes["uncertainty"], sizes["half_width_68"], factors[0], sizes["half_width_95"], factors[1],
            sizes["systematic"], sizes["reported_68"], sizes["reported_95"],
        )  # fmt: skip
    console.print(combined)
    console.print(
        "(source): off, with a typical size. c: m and m/s per unit of the input. A: random, as repeated shots "
        "show it; B: from a bound, a calibration or a model. Student t: of 2 degrees of freedom, which has no "
        "variance; u is its 68.27 % half-width. known: systematic, not part of u."
    )


def _cells(source: UncertaintySource) -> tuple[str, ...]:
    name = source.name if source.on else f"({source.name})"
    parts = (
        text
        for part in (source.range_m, source.speed_mps)
        for text in (_digits(2, part.sensitivity), _digits(3, 1e3 * part.uncertainty))
    )
    return name, source.type, source.law, f"{_digits(3, source.input_uncertainty)} {source.unit}", *parts


def _digits(count: int, value: float) -> str:
    """Significant digits, without an exponent from 0.0001 to 999 999; 0 for what rounding leaves of a difference."""
    return f"{float(f'{value:.{count}g}') if abs(value) > _ROUNDING else 0.0:g}"
