"""A console of rich that prints text as it is: names come from files of others, and may hold escape sequences."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table

from lidar_emu.errors import printable

_LEAST_COLUMNS = 40
"""Below it, tables of rich lose columns without a word; a serial terminal may state 0."""


class PlainConsole(Console):
    """A console without markup, emoji codes and highlights, and without characters that a terminal would obey."""

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, **options)
        if self.width < _LEAST_COLUMNS:
            self.width = _LEAST_COLUMNS

    def print_lines(self, *lines: str) -> None:
        """Print lines that the console does not break."""
        for line in lines:
            self.print(line, soft_wrap=True)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render as `Console` does; control sequences of rich itself stay."""
        for text, style, control in super().render(renderable, options):
            yield Segment(text if control else printable(text), style, control)


def plain_table(*headings: str, title: str | None = None, texts: int = 0) -> Table:
    """A table with a line below its headings; the first `texts` columns hold text, the others numbers."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=0)
    for place, heading in enumerate(headings):
        table.add_column(heading, justify="left" if place < texts else "right")
    return table
