"""Style of plots: colours, legends, axis limits, and how they are saved."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, ParamSpec, TypeVar

import numpy as np

from lidar_emu.files import check_destination, check_extra, check_suffix, whole_file
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.report.beam_colours import BEAM_COLOURS, beam_colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure


_P = ParamSpec("_P")
_T = TypeVar("_T")
WIDTH_INCH = 10.0
_DOTS_PER_INCH = 110
FINE_DPI = 160
"""Of figures small in inches, whose letters stay legible where a page shows half of the pixels."""
INK = "#3b4048"
"""Colour of lines and text; in SVG it is replaced by the page's text colour."""
GRID = "#8a919c"
"""A grey that is visible on white and on black."""
DARK_INK, DARK_PAPER = "#dde1e6", "#14171b"
"""Colours of the report's page on a dark screen."""
FAULT_COLOUR = PATH_COLOUR = "#d1495b"
_STYLE: Any = {
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), INK),
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.prop_cycle": "cycler('color', [" + ", ".join(f"'{colour}'" for colour in BEAM_COLOURS) + "])",
    "axes.spines.right": False,
    "axes.spines.top": False,
    "figure.constrained_layout.h_pad": 0.08,
    "figure.constrained_layout.w_pad": 0.08,
    "figure.dpi": _DOTS_PER_INCH,
    "font.size": 9.0,
    "grid.alpha": 0.25,
    "grid.color": GRID,
    "legend.frameon": False,
    "svg.fonttype": "none",
}
BEAMS_IN_LEGEND = 12
_FEW_POINTS = 20_000
_PART_POINTS = 1 << 16
_CELLS_ACROSS, _CELLS_UP = 3000, 1200
"""Cells are smaller than a dot of a figure: coarser ones thin the lines that dense points make."""


PLOT_FORMATS: dict[str, Any] = {
    "png": {},
    "svg": {"metadata": {"Date": None}, "dpi": 300},
    "pdf": {"metadata": {"CreationDate": None}, "dpi": 300},
}
"""Formats of plots, by suffix, with arguments of `savefig`: no date, and a resolution of what is rasterised."""


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


def styled(draw: Callable[_P, _T]) -> Callable[_P, _T]:
    """Give what a function draws the style of all figures."""

    @wraps(draw)
    def drawn(*values: _P.args, **named: _P.kwargs) -> _T:
        from matplotlib import rc_context

        with rc_context(_STYLE):
            return draw(*values, **named)

    return drawn


def as_svg(drawing: Drawing) -> str:
    """Render an `svg` element with text in the page's colour and identifiers that are unique in the page."""
    from matplotlib import rc_context

    buffer = BytesIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with rc_context({**_STYLE, "svg.hashsalt": drawing.name}):
        drawing.figure.savefig(buffer, format="svg", transparent=True, metadata=nothing)
    text = buffer.getvalue().decode()
    text = text[text.index("<svg") :].replace(INK, "currentColor")
    return re.sub(r'( id="|url\(#|href="#)', rf"\g<1>{drawing.name}-", text)


def write_drawing(drawing: Drawing, path: Path) -> None:
    """Write a figure of the report, see `write_plot`.

    Raises:
        InputError: the file cannot be written.
        RunError: writing failed.
    """
    from matplotlib import rc_context

    with rc_context(_STYLE):
        write_plot(drawing.figure, path)


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
    points(axes, x, y, 1.0 - 0.6 * beam / beam_count, color=beam_colour(beam), zorder=2)


def name_beams(axes: Axes, beam_count: int) -> None:
    """Add a legend of the beams beside the axes, unless there is one beam or too many."""
    if 1 < beam_count <= BEAMS_IN_LEGEND:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), handletextpad=0.1, markerscale=3.0)


_FENCE = 5.0
"""Distance of the outlier fences from the median in interquartile ranges: 6.7 standard deviations if normal."""
_ROOM = 0.25
"""Share of the span of the ground truth by which limits may exceed it on each side."""
_MARGIN = 0.04


class Limits(NamedTuple):
    """Lower and upper limit of an axis."""

    low: float
    high: float

    def contain(self, values: FloatArray) -> BoolArray:
        """Whether finite values are inside; NaN is not."""
        return np.asarray((values >= self.low) & (values <= self.high))


def error_limits(errors: FloatArray, least: float) -> Limits:
    """Compute limits of errors: the farthest values within the fences (Tukey) about their median.

    Args:
        errors: values, of which NaN is ignored.
        least: half width about zero that the limits contain in any case, greater than 0.
    """
    known = errors[np.isfinite(errors)]
    kept = Limits(-least, least)
    if not known.size:
        return kept
    lower, median, upper = np.quantile(known, (0.25, 0.5, 0.75))
    reach = _FENCE * (upper - lower)
    return _reached(known, kept, Limits(median - reach, median + reach))


def truth_limits(measured: FloatArray, true: FloatArray) -> Limits:
    """Compute limits of measured values: the span of the ground truth, and measured values slightly beyond it.

    Args:
        measured: values, of which NaN is ignored.
        true: ground truth; without any, all measured values are contained.
    """
    known = measured[np.isfinite(measured)]
    truth = true[np.isfinite(true)]
    kept = _hull(truth if truth.size else known if known.size else np.zeros(1))
    room = _ROOM * (kept.high - kept.low)
    return _reached(known, kept, Limits(kept.low - room, kept.high + room))


def _reached(values: FloatArray, kept: Limits, fences: Limits) -> Limits:
    """Extend the limits `kept` to the values within the fences, and by a margin."""
    low, high = _hull(np.concatenate([values[fences.contain(values)], kept]))
    margin = _MARGIN * (high - low) or 0.5
    return Limits(low - margin, high + margin)


def _hull(values: FloatArray) -> Limits:
    return Limits(float(values.min()), float(values.max()))


def limited_points(
    axes: Axes, beam: int, beam_count: int, x: FloatArray, y: FloatArray, limits: Limits
) -> None:
    """Plot the points of one beam, with triangles at the edge for the points beyond the limits."""
    axes.set_ylim(limits)
    inside = limits.contain(y)
    beam_points(axes, beam, beam_count, x[inside], y[inside])
    mark_outside(axes, beam_colour(beam), x, y, limits)


def mark_outside(axes: Axes, colour: str, x: FloatArray, y: FloatArray, limits: Limits) -> None:
    """Mark points beyond the limits by triangles at the edge."""
    for beyond, edge, marker in ((y < limits.low, limits.low, "v"), (y > limits.high, limits.high, "^")):
        if beyond.any():
            axes.plot(
                x[beyond],
                np.full(int(beyond.sum()), edge),
                marker,
                color=colour,
                markersize=4.0,
                markeredgewidth=0.0,
                clip_on=False,
                rasterized=True,
                zorder=3,
            )


def number_log_axis(axis: Axis, subs: Sequence[float] = (1.0, 2.0, 5.0)) -> None:
    """Label these multiples of the powers of ten of a logarithmic axis by plain numbers."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def outside_words(count: int) -> str:
    """State in a caption how many values the limits leave out; nothing if none."""
    return f" {count} outside the axes: triangles at the edge." if count else ""


def titled_figure(
    title: str,
    size_inch: tuple[float, float],
    font_size: float,
    dpi: int = 125,
) -> Figure:
    """Create a figure for `write_plot`. The title is a sentence: its first letter becomes a capital."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_inch, dpi=dpi, layout="constrained")
    figure.suptitle(title[:1].upper() + title[1:], fontsize=font_size)
    return figure


def check_plot_path(path: Path) -> None:
    """Check the path of a plot before a long run.

    Raises:
        InputError: the suffix names no format, the folder is missing or read-only, or the extra `plots` is missing.
    """
    check_suffix(path, [f".{suffix}" for suffix in PLOT_FORMATS])
    check_extra(str(path), path.suffix, "matplotlib", "plots")
    check_destination(path)


def write_plot(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, SVG or PDF, by the suffix; the same figure gives the same bytes.

    A figure whose file name ends in `-dark` before the suffix becomes light on dark.

    Raises:
        RunError: writing failed.
    """
    from matplotlib import rc_context

    if path.stem.endswith("-dark"):
        _darken(figure)
    suffix = path.suffix.removeprefix(".")
    with rc_context({"svg.hashsalt": "lidar-emu"}), whole_file(path) as file:
        figure.savefig(file, format=suffix, **PLOT_FORMATS[suffix])


def _darken(figure: Figure) -> None:
    """Exchange ink and white faces of all that is drawn for dark ones; other colours suit both grounds."""
    from matplotlib.colors import to_rgb, to_rgba_array

    artists: list[Any] = figure.findobj()
    artists += [artist.arrow_patch for artist in artists if getattr(artist, "arrow_patch", None)]
    artists += [artist.get_bbox_patch() for artist in artists if getattr(artist, "get_bbox_patch", None)]
    for artist in artists:
        for part in ("color", "facecolor", "edgecolor", "markerfacecolor", "markeredgecolor"):
            if not hasattr(artist, f"get_{part}"):
                continue
            colours = to_rgba_array(getattr(artist, f"get_{part}")())
            exchanged = {INK: DARK_INK, "white": DARK_PAPER} if "face" in part else {INK: DARK_INK}
            for light, dark in exchanged.items():
                found = (colours[:, :3] == to_rgb(light)).all(axis=1)
                if found.any():
                    colours[found, :3] = to_rgb(dark)
                    getattr(artist, f"set_{part}")(colours if len(colours) > 1 else colours[0])
