"""Tables of docs/evidence/accuracy.md that a tool makes anew, each between two markers."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from pathlib import Path

PAGE = Path(__file__).resolve().parents[1] / "docs" / "evidence" / "accuracy.md"

Rows = Callable[[int], Iterable[tuple[str, ...]]]


def update(
    name: str,
    headings: tuple[str, ...],
    rows: Rows,
    shots: int,
    fast_times: int | None,
    arguments: list[str] | None = None,
) -> None:
    """Print the rows of a table as they are measured, and write them to the page unless asked not to.

    Args:
        name: name of the table in its markers.
        headings: of its columns.
        rows: generator of the rows from the number of measurements of the reference.
        shots: that number unless the command line has another.
        fast_times: measurements of the fast levels per measurement of the reference; None where there is no reference
            and the number is a row's.
        arguments: the command line's, if the tool has taken some.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("--print", action="store_true", dest="only_print")
    parser.add_argument("--shots", type=int, default=shots)
    options = parser.parse_args(arguments)
    lines = [_line(headings), _line(("---",) * len(headings))]
    for row in rows(options.shots):
        lines.append(_line(row))
        print(lines[-1], flush=True)
    if options.only_print:
        return
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    before, rest = PAGE.read_text().split(begin)
    _, after = rest.split(end)
    counts = f"{options.shots} measurements a row"
    if fast_times is not None:
        counts = f"{options.shots} measurements of the reference, {fast_times * options.shots} of the others"
    text = "\n".join(lines)
    PAGE.write_text(f"{before}{begin}\n{text}\n\n{counts}, on {datetime.now(UTC).date()}.\n{end}{after}")


def _line(row: tuple[str, ...]) -> str:
    return "| " + " | ".join(row) + " |"
