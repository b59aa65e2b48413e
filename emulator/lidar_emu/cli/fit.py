"""`lidar-emu fit`: a sensor characterised from a log of its flight."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lidar_emu.cli.options import as_number, as_whole
from lidar_emu.cli.terminal import busy, print_line, show_step, write_text
from lidar_emu.errors import InputError, listed, one_line
from lidar_emu.files import check_destination, check_extra, check_keeps

if TYPE_CHECKING:
    from lidar_emu.sensor_fit.instrument_keys import FittedKeys
    from lidar_emu.sensor_fit.validation import Fit

_SHORTEST_BLOCK_S, _LONGEST_BLOCK_S = 0.1, 1000.0


@click.command(
    short_help="Characterise a sensor from a log of its flight, and predict the half that is held out."
)
@click.argument("log")
@click.option(
    "--column",
    "columns",
    metavar="KEY=NAME",
    multiple=True,
    help="Name of a column in a CSV file; * stands for the beam: --column 'range_m=Range[*]'. Repeatable.",
)
@click.option(
    "--block",
    metavar="S",
    default="2",
    show_default=True,
    help="Length of the blocks of which every second is held out.",
)
@click.option(
    "--scenario",
    metavar="FILE.yaml",
    help="Motion and ground of the flight, and the instrument to begin with.",
)
@click.option("--instrument", metavar="FILE.yaml", help="Fit the instrument's keys by flights of --scenario.")
@click.option(
    "--seed", metavar="N", default="1", show_default=True, help="Seed of the flights for --instrument."
)
@click.option("--html", metavar="FILE.html", help="Write one HTML page with figures; it needs no network.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")  # fmt: skip
def fit(
    log: str, columns: tuple[str, ...], block: str, scenario: str | None, instrument: str | None, seed: str,
    html: str | None, as_json: bool,
) -> None:  # fmt: skip
    """Characterise the sensor of LOG, a CSV file or a recording: steps, limits, noise, dropouts, bias and latency.

    Each figure has a 90 % interval, by every second block of the log; the verdict compares the blocks between with what
    the figures predict. Without columns of truth the motion is smoothed from the values themselves.

    \b
    lidar-emu simulate descent.yaml --out flight.csv
    lidar-emu fit flight.csv --html fit.html
    lidar-emu fit log.csv --column time_s=T --column 'range_m=R[*]' --column 'closing_speed_mps=V[*]'
    lidar-emu fit flight.csv --scenario descent.yaml --instrument fitted.yaml
    """
    path, named, block_s = Path(log), _named(columns), as_number("--block", block)
    if not _SHORTEST_BLOCK_S <= block_s <= _LONGEST_BLOCK_S:
        remedy = f"must be from {_SHORTEST_BLOCK_S:g} to {_LONGEST_BLOCK_S:g} seconds"
        raise InputError("--block", None, block, remedy)
    page = None if html is None else Path(html)
    if page is not None:
        check_keeps(path, page, "--html")
        check_destination(page, "--html", [".html", ".htm"])
        check_extra("fit", "figures", "matplotlib", "plots")
    written = None if instrument is None else _instrument_path(path, instrument, scenario)
    if written is None and scenario is not None:
        raise InputError("--scenario", None, scenario, "needs --instrument FILE.yaml")
    seed_number = as_whole("--seed", seed)
    from lidar_emu.sensor_fit.flight_log import read_log
    from lidar_emu.sensor_fit.validation import fit_log

    with busy(f"fitting {log}"):
        found = fit_log(read_log(path, named), block_s)
    keys, text = None, ""
    if written is not None and scenario is not None:
        keys, text = _fitted_keys(found, scenario, written.stem, block_s, seed_number)
        write_text(written, text)
    if page is not None:
        from lidar_emu.sensor_fit.page import write_fit_page

        write_fit_page(page, found)
    if as_json:
        import orjson

        # It writes null for what is not finite.
        how = orjson.OPT_INDENT_2 | orjson.OPT_SERIALIZE_NUMPY
        document = _document(found) | ({} if keys is None else _keys_document(keys))
        print_line(orjson.dumps(document, option=how).decode())
    else:
        _print(found)
        for line in text.splitlines():
            print_line(line)


def _instrument_path(log: Path, instrument: str, scenario: str | None) -> Path:
    path = Path(instrument)
    if scenario is None:
        raise InputError(
            "--instrument", None, instrument, "needs --scenario FILE.yaml, the flight of the log"
        )
    check_keeps(log, path, "--instrument")
    check_keeps(Path(scenario), path, "--instrument")
    check_destination(path, "--instrument", [".yaml"])
    return path


def _fitted_keys(found: Fit, scenario: str, name: str, block_s: float, seed: int) -> tuple[FittedKeys, str]:
    """The keys, and the text of the instrument's file."""
    from lidar_emu.scenario.load import load, require_flight, require_known_flight
    from lidar_emu.sensor_fit.instrument_keys import (
        CHECKING_FLIGHTS,
        FLIGHTS,
        fit_keys,
        instrument_text,
        problem_of,
    )

    flown = require_flight(require_known_flight(load(scenario)))
    if flown.level != "spectral":
        raise InputError(scenario, "level", flown.level, "must be spectral, where keys of the receiver act")

    def show(done: int) -> None:
        show_step(f"flight {done} of {FLIGHTS + CHECKING_FLIGHTS}")

    with busy("preparing the flights"):
        problem = problem_of(found.log, found.sensor, flown, block_s)
    try:
        keys = fit_keys(found.log, problem, seed, FLIGHTS, show)
    finally:
        show_step("")
    source = f"Fitted to {found.log.name} by {FLIGHTS} flights of {Path(scenario).name}, seed {seed} (lidar-emu fit)."
    return keys, instrument_text(keys, name, one_line(source))


def _keys_document(keys: FittedKeys) -> dict[str, Any]:
    return {
        "keys": [
            {"key": key, **estimate._asdict(), "tells": tells} for key, estimate, tells in keys.estimates
        ],
        "peak": keys.peak_shares,
        "key_figures": keys.figures,
        "key_figures_inside": keys.inside,
    }


def _named(columns: tuple[str, ...]) -> dict[str, str]:
    from lidar_emu.sensor_fit.flight_log import COLUMNS

    named = {}
    for each in columns:
        key, equals, name = each.partition("=")
        if key not in COLUMNS or not equals or not name:
            raise InputError("--column", None, each, f"must be KEY=NAME, KEY one of {listed(COLUMNS)}")
        named[key] = name
    return named


def _document(found: Fit) -> dict[str, Any]:
    rows = found.sensor.rows
    return {
        "log": found.log.name,
        "shots": len(found.log.time_s),
        "beams": found.log.time_s.shape[1],
        "reference": "smoothed" if found.sensor.errors.smoothed else "truth",
        "figures": [{**row._asdict(), "estimate": None, **row.estimate._asdict()} for row in rows],
        "checks": [{**check._asdict(), "inside": check.inside} for check in found.checks],
    }


def _print(found: Fit) -> None:
    from lidar_emu.cli.plain_console import PlainConsole, plain_table
    from lidar_emu.sensor_fit.page import check_texts, row_texts, verdict_line

    reference = "its smoothed motion" if found.sensor.errors.smoothed else "its truth"
    table = plain_table(
        "figure", "at", "value (90 %)", "unit", "note", title=f"{found.log.name} against {reference}", texts=2
    )
    for row in found.sensor.rows:
        table.add_row(*row_texts(row))
    checks = plain_table("held-out half", "value", "90 % band", "", texts=1)
    for check in found.checks:
        checks.add_row(*check_texts(check))
    console = PlainConsole()
    console.print(table)
    console.print(checks)
    console.print(verdict_line(found))
