"""How the figures of a page look: drawn once, shown as SVG in the colours of the reader, or written as PNG."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lidar_emu.files import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_INCH = 10.0
_DOTS_PER_INCH = 110
_INK = "#3b4048"
"""Of lines and letters: dark enough on white, and exchanged for the reader's own colour in SVG."""
GRID = "#8a919c"
"""Seen on white and on black."""
_STYLE: Any = {
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), _INK),
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "figure.dpi": _DOTS_PER_INCH,
    "font.size": 9.0,
    "grid.alpha": 0.25,
    "grid.color": GRID,
    "legend.frameon": False,
    "svg.fonttype": "none",
}
_BEAMS_IN_LEGEND = 12


@dataclass(frozen=True)
class Drawing:
    """A figure of a page."""

    name: str
    """Of its file, without suffix."""
    title: str
    says: str
    """What it shows, in words: for those who do not see it."""
    figure: Figure


def draw(name: str, title: str, says: str, height_inch: float, on: Callable[[Figure], None]) -> Drawing:
    """Have a figure drawn in the style of the pages."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(_STYLE):
        figure = Figure(figsize=(WIDTH_INCH, height_inch), layout="constrained")
        on(figure)
    return Drawing(name, title, says, figure)


def as_svg(drawing: Drawing) -> str:
    """An `svg` element for a page: letters in the page's colour, its names apart from those of other figures."""
    from matplotlib import rc_context

    buffer = BytesIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with rc_context({**_STYLE, "svg.hashsalt": drawing.name}):
        drawing.figure.savefig(buffer, format="svg", transparent=True, metadata=nothing)
    text = buffer.getvalue().decode()
    text = text[text.index("<svg") :].replace(_INK, "currentColor")
    return re.sub(r'( id="|url\(#|href="#)', rf"\g<1>{drawing.name}-", text)


def write_png(drawing: Drawing, path: Path) -> None:
    """Write a figure on white.

    Raises:
        InputError: nothing can be written there.
        RunError: writing failed on the way.
    """
    from matplotlib import rc_context

    with rc_context(_STYLE), whole_file(path) as file:
        drawing.figure.savefig(file, format="png", facecolor="white")


def points(axes: Axes, x: Any, y: Any, share: float = 1.0, **how: Any) -> None:
    """Many points: as pixels in SVG, so that an hour of them is no heavier than a minute."""
    size = share * (5.0 if len(x) < 400 else 3.5 if len(x) < 4000 else 2.0)
    axes.plot(x, y, ".", markersize=size, markeredgewidth=0.0, rasterized=True, **how)


def beam_points(axes: Axes, beam: int, beam_count: int, x: Any, y: Any) -> None:
    """Those of one beam, smaller from beam to beam: where beams agree, all of them are seen."""
    points(axes, x, y, 1.0 - 0.6 * beam / beam_count, color=f"C{beam % 10}", zorder=2)


def name_beams(axes: Axes, beam_count: int) -> None:
    """A legend of the beams beside the axes, where it is of use."""
    if 1 < beam_count <= _BEAMS_IN_LEGEND:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), handletextpad=0.1, markerscale=3.0)
