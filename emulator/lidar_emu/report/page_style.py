"""Style of the report's figures, which are drawn once and saved as SVG in the page's colours or as PNG."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lidar_emu.files import whole_file
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_INCH = 10.0
_DOTS_PER_INCH = 110
_INK = "#3b4048"
"""Colour of lines and text; in SVG it is replaced by the page's text colour."""
GRID = "#8a919c"
"""A grey that is visible on white and on black."""
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
_FEW_POINTS = 20_000
_PART_POINTS = 1 << 16
_CELLS_ACROSS, _CELLS_UP = 3000, 1200
"""Cells are smaller than a dot of a figure: coarser ones thin the lines that dense points make."""


@dataclass(frozen=True)
class Drawing:
    """A figure of the report with its title and text description."""

    name: str
    """Name of its file without suffix, and of its element in the page."""
    title: str
    description: str
    """Caption, and alternative text for screen readers."""
    figure: Figure


def draw_figure(
    name: str, title: str, description: str, height_inch: float, plot: Callable[[Figure], None]
) -> Drawing:
    """Create a figure in the style of the report, and let `plot` fill it."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(_STYLE):
        figure = Figure(figsize=(WIDTH_INCH, height_inch), layout="constrained")
        plot(figure)
    return Drawing(name, title, description, figure)


def as_svg(drawing: Drawing) -> str:
    """Render an `svg` element with text in the page's colour and identifiers that are unique in the page."""
    from matplotlib import rc_context

    buffer = BytesIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with rc_context({**_STYLE, "svg.hashsalt": drawing.name}):
        drawing.figure.savefig(buffer, format="svg", transparent=True, metadata=nothing)
    text = buffer.getvalue().decode()
    text = text[text.index("<svg") :].replace(_INK, "currentColor")
    return re.sub(r'( id="|url\(#|href="#)', rf"\g<1>{drawing.name}-", text)


def write_png(drawing: Drawing, path: Path) -> None:
    """Write a figure on a white background.

    Raises:
        InputError: the file cannot be written.
        RunError: writing failed.
    """
    from matplotlib import rc_context

    with rc_context(_STYLE), whole_file(path) as file:
        drawing.figure.savefig(file, format="png", facecolor="white")


def distinct(x: FloatArray, y: FloatArray) -> IntArray:
    """Select points that are distinct on a figure: the first one in each cell of a grid over all of them.

    Args:
        x, y: (points,) coordinates; points with NaN are left out where there are many.

    Returns:
        (selected,) Indices in ascending order; every point where there are few.
    """
    if len(x) <= _FEW_POINTS:
        return np.arange(len(x))
    known = np.isfinite(x) & np.isfinite(y)
    across, up = _to_cells(x, known, _CELLS_ACROSS), _to_cells(y, known, _CELLS_UP)
    first = np.full(_CELLS_ACROSS * _CELLS_UP, -1, dtype=np.int64)
    # By parts from the last one, so that the first point of a cell is the last one written, in bounded memory.
    for begin in reversed(range(0, len(x), _PART_POINTS)):
        index = begin + np.flatnonzero(known[begin : begin + _PART_POINTS])[::-1]
        first[across(x[index]) * _CELLS_UP + up(y[index])] = index
    return np.asarray(np.sort(first[first >= 0]))


def _to_cells(values: FloatArray, known: BoolArray, cells: int) -> Callable[[FloatArray], IntArray]:
    """Return what finds the cell of a value, of so many over the span of the known values."""
    low, high = values.min(where=known, initial=np.inf), values.max(where=known, initial=-np.inf)
    scale = (cells - 1) / ((high - low) or 1.0)
    return lambda part: ((part - low) * scale).astype(np.int64)


def points(axes: Axes, x: FloatArray, y: FloatArray, share: float = 1.0, **how: Any) -> None:
    """Plot many points, rasterised in SVG so that the file size does not grow with their number."""
    size = share * (5.0 if len(x) < 400 else 3.5 if len(x) < 4000 else 2.0)
    shown = distinct(x, y)
    axes.plot(x[shown], y[shown], ".", markersize=size, markeredgewidth=0.0, rasterized=True, **how)


def beam_points(axes: Axes, beam: int, beam_count: int, x: FloatArray, y: FloatArray) -> None:
    """Plot the points of one beam; markers shrink from beam to beam, so that coinciding beams all stay visible."""
    points(axes, x, y, 1.0 - 0.6 * beam / beam_count, color=f"C{beam % 10}", zorder=2)


def name_beams(axes: Axes, beam_count: int) -> None:
    """Add a legend of the beams beside the axes, unless there is one beam or too many."""
    if 1 < beam_count <= _BEAMS_IN_LEGEND:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), handletextpad=0.1, markerscale=3.0)
