"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def table(heading: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    """A table with a heading."""
    head, *lines = (f"| {' | '.join(map(str, cells))} |" for cells in (heading, *rows))
    return "\n".join([head, "|" + "---|" * len(heading), *lines])
