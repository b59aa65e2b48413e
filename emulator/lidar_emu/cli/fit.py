"""`lidar-emu fit`: a sensor characterised from a log of its flight."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lidar_emu.cli.options import as_number
from lidar_emu.cli.terminal import busy, print_line
from lidar_emu.errors import InputError, listed
from lidar_emu.files import check_destination, check_extra, check_keeps, check_suffix

if TYPE_CHECKING:
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
@click.option("--html", metavar="FILE.html", help="Write one HTML page with figures; it needs no network.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")  # fmt: skip
def fit(log: str, columns: tuple[str, ...], block: str, html: str | None, as_json: bool) -> None:
    """Characterise the sensor of LOG, a CSV file or a recording: steps, limits, noise, dropouts, bias and latency.

    Each figure has a 90 % interval, by every second block of the log; the verdict compares the blocks between with what
    the figures predict. Without columns of truth the motion is smoothed from the values themselves.

    \b
    lidar-emu simulate descent.yaml --out flight.csv
    lidar-emu fit flight.csv --html fit.html
    lidar-emu fit log.csv --column time_s=T --column 'range_m=R[*]' --column 'closing_speed_mps=V[*]'
    """
    path, named, block_s = Path(log), _named(columns), as_number("--block", block)
    if not _SHORTEST_BLOCK_S <= block_s <= _LONGEST_BLOCK_S:
        remedy = f"must be from {_SHORTEST_BLOCK_S:g} to {_LONGEST_BLOCK_S:g} seconds"
        raise InputError("--block", None, block, remedy)
    page = None if html is None else Path(html)
    if page is not None:
        check_keeps(path, page, "--html")
        check_destination(page, "--html")
        check_suffix(page, [".html", ".htm"], "--html")
        check_extra("fit", "figures", "matplotlib", "plots")
    from lidar_emu.sensor_fit.flight_log import read_log
    from lidar_emu.sensor_fit.validation import fit_log

    with busy(f"fitting {log}"):
        found = fit_log(read_log(path, named), block_s)
    if page is not None:
        from lidar_emu.sensor_fit.page import write_fit_page

        write_fit_page(page, found)
    if as_json:
        import orjson

        # It writes null for what is not finite.
        how = orjson.OPT_INDENT_2 | orjson.OPT_SERIALIZE_NUMPY
        print_line(orjson.dumps(_document(found), option=how).decode())
    else:
        _print(found)


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
    console.print(verdict_line(found), highlight=False)
