"""Measure the tables of the documentation, and write each between its markers.

python -m benchmarks.tables                      lists the tables and the time that each takes
python -m benchmarks.tables haze plume           measures two tables and updates their pages
python -m benchmarks.tables sigma --print        prints a table and leaves its page alone
python -m benchmarks.tables speckle --shots 300  with fewer measurements of a row than usual
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import re
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

DOCS = Path(__file__).resolve().parents[1] / "docs"
SHIPPED = DOCS.parent / "emulator" / "lidar_emu" / "shipped"

Part = tuple[str, ...] | str
"""A row of a table, of which the first is the heading; or a paragraph, which ends a table."""


class Table(NamedTuple):
    """Tables between the markers of a page, `<!-- NAME: begin -->` and `<!-- NAME: end -->`."""

    page: str
    module: str
    takes: str
    shots: int = 0
    """Measurements of the reference, or of a row where there is no reference; 0: the number is fixed."""
    fast_times: int = 0
    """Measurements of the fast levels for each of the reference; 0: there is no reference."""
    function: str = "parts"
    """Yields the parts; its argument is the number of measurements, if that can be chosen."""
    shipped: str = ""
    """File with the same rows for the wheel, in `lidar_emu/shipped`."""


TABLES = {
    "speckle": Table("evidence/accuracy.md", "speckle_table", "50 min", 2000, 4),
    "left out": Table("evidence/accuracy.md", "left_out_table", "10 min", 60, 16),
    "sigma": Table("evidence/accuracy.md", "sigma_table", "15 min", 300, 10),
    "looks": Table("evidence/accuracy.md", "sigma_table", "2 min", 2000, function="looks_parts"),
    "depth sigma": Table("evidence/accuracy.md", "depth_sigma", "2 min", 600),
    "flight ranges": Table("evidence/accuracy.md", "depth_sigma", "20 s", function="flight_parts"),
    "flight sigma": Table("evidence/accuracy.md", "flight_sigma", "10 s"),
    "haze": Table("evidence/accuracy.md", "volume_tables", "10 min", 1000, 10),
    "plume": Table("evidence/accuracy.md", "volume_tables", "3 min", 400, 10, "plume_parts"),
    "published": Table("evidence/published.md", "published_rows", "15 min", shipped="published.csv"),
    "unmodelled": Table("evidence/error-sources.md", "unmodelled_errors", "10 s"),
    "uncertainty": Table("evidence/uncertainty.md", "uncertainty", "10 min", 100_000),
    "uncertainty sources": Table(
        "evidence/uncertainty.md", "uncertainty", "3 min", 20_000, function="source_parts"
    ),
    "solvers": Table("evidence/flights.md", "descent_solvers", "3 min"),
    "geometry": Table("evidence/performance.md", "geometry_costs", "2 min"),
    "lateness": Table("evidence/timing.md", "how_late", "21 min"),
    "viewers": Table("evidence/performance.md", "viewer_lateness", "8 min"),
    "ratios": Table("evidence/performance.md", "performance", "5 min", function="ratio_parts"),
    "starts": Table("evidence/performance.md", "performance", "3 min", function="start_parts"),
    "growth": Table("evidence/performance.md", "performance", "20 min", function="growth_parts"),
}


def parts_of(table: Table, shots: int) -> Iterable[Part]:
    """Measure a table."""
    function: Callable[..., Iterable[Part]] = getattr(
        import_module(f"benchmarks.{table.module}"), table.function
    )
    if not table.shots:
        yield from function()
        return
    yield from function(shots)
    counts = f"{shots} measurements a row"
    if table.fast_times:
        counts = f"{shots} measurements of the reference, {table.fast_times * shots} of the others"
    yield f"{counts}, on {datetime.now(UTC).date()}."


def markdown(parts: Iterable[Part]) -> str:
    """Join parts to Markdown, and print each when it has been measured."""
    lines: list[str] = []
    in_table = False
    for part in parts:
        if not part:
            in_table = False
            continue
        new = [part] if isinstance(part, str) else [f"| {' | '.join(part)} |"]
        if not in_table and not isinstance(part, str):
            new.append("|" + "---|" * len(part))
        if lines and (not in_table or isinstance(part, str)):
            new.insert(0, "")
        in_table = not isinstance(part, str)
        print("\n".join(new), flush=True)
        lines += new
    return "\n".join(lines)


def update(page: Path, name: str, text: str) -> None:
    """Replace what stands between the markers of a page."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    before, rest = page.read_text().split(begin)
    _, after = rest.split(end)
    page.write_text(f"{before}{begin}\n{text}\n{end}{after}")


def table_rows(text: str) -> list[list[str]]:
    """The cells of a table in Markdown, without the line below its heading."""
    lines = [line for line in text.splitlines() if line.startswith("|") and not line.startswith("|--")]
    return [[cell.strip(" *`") for cell in line.strip("|").split("|")] for line in lines]


def machine() -> str:
    """Date and machine of a measurement, for the end of a table."""
    cpuinfo = Path("/proc/cpuinfo")
    text = cpuinfo.read_text() if cpuinfo.exists() else ""
    models = re.findall(r"^model name\s*: (.*)$", text, re.MULTILINE)
    return (
        f"Measured {datetime.now(UTC).date()} on {os.cpu_count()} cores of {(models or [platform.machine()])[0]}, "
        f"Linux {platform.release()}, Python {platform.python_version()}."
    )


def command_line(description: str | None) -> argparse.ArgumentParser:
    """A parser that prints a module's docstring as it is."""
    return argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def main() -> None:
    """Measure the tables that the command line names."""
    parser = command_line(__doc__)
    parser.add_argument("names", nargs="*", metavar="TABLE")
    parser.add_argument("--print", action="store_true", dest="only_print")
    parser.add_argument("--shots", type=int)
    options = parser.parse_args()
    if unknown := [name for name in options.names if name not in TABLES]:
        parser.error(f"unknown table {unknown[0]!r}; must be one of: {', '.join(TABLES)}")
    if not options.names:
        for name, table in TABLES.items():
            print(f"{name:14}{table.takes:>8}  docs/{table.page}")
    for name in options.names:
        table = TABLES[name]
        text = markdown(parts_of(table, options.shots or table.shots))
        if not options.only_print:
            update(DOCS / table.page, name, text)
            if table.shipped:
                with (SHIPPED / table.shipped).open("w", newline="") as file:
                    csv.writer(file, lineterminator="\n").writerows(table_rows(text))


if __name__ == "__main__":
    main()
