"""Work-precision plot: error over computing time, a point per setting, with the Pareto front."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from lidar_emu.report.legends import legend_above
from lidar_emu.report.png_file import check_plot_path, write_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIZE_INCH = (16.0, 11.0)
_DOTS_PER_INCH = 100
_MARKERS = "osD^vP"


class Mark(NamedTuple):
    """One setting with its error and computing time."""

    family: str
    """Settings of a family share colour and marker."""
    label: str
    """Label of the point if it is on the Pareto front."""
    time_s: float
    error: float
    on_front: bool


def plot_work_precision(
    panels: Sequence[tuple[str, Sequence[Mark], float | None]], title: str, path: Path
) -> None:
    """Plot panels side by side as a PNG of 1600 by 1100 pixels.

    Args:
        panels: for each panel, the name and unit of the error, the settings, and the statistical resolution of the
            comparison. The reference has an error of 0 and is plotted on the lower edge.
        title: title of the figure.
        path: file, `.png`.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    write_png(_draw(panels, title), path)


def _draw(panels: Sequence[tuple[str, Sequence[Mark], float | None]], title: str) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_INCH, dpi=_DOTS_PER_INCH, layout="constrained")
    figure.suptitle(title, fontsize=17)
    for axes, (name, marks, floor) in zip(
        figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True
    ):
        _add_panel(axes, marks, floor)
        axes.set(xscale="log", yscale="log", xlabel="time per beam measurement (s)", ylabel=name)
        axes.grid(color="0.92")
        legend_above(axes, columns=3)
    return figure


def _add_panel(axes: Axes, marks: Sequence[Mark], floor: float | None) -> None:
    lowest = 0.3 * min((mark.error for mark in marks if mark.error > 0.0), default=1.0)
    front = sorted((mark.time_s, max(mark.error, lowest)) for mark in marks if mark.on_front)
    axes.plot(*zip(*front, strict=True), color="0.6", linewidth=1.2, zorder=1, label="Pareto front")
    if floor is not None and floor > 0.0:
        axes.axhline(floor, color="0.6", linestyle=":", zorder=1, label="statistical resolution")
    for number, family in enumerate(dict.fromkeys(mark.family for mark in marks)):
        label: str | None = family
        for size, edge, is_front in ((7.0, "none", False), (11.0, "black", True)):
            shown = [mark for mark in marks if (mark.family, mark.on_front) == (family, is_front)]
            if not shown:
                continue
            axes.plot(
                [mark.time_s for mark in shown],
                [max(mark.error, lowest) for mark in shown],
                _MARKERS[number % len(_MARKERS)],
                color=f"C{number % 10}",
                markersize=size,
                markeredgecolor=edge,
                label=label,
                zorder=2,
            )
            label = None
    for mark in marks:
        if mark.on_front:
            place = (mark.time_s, max(mark.error, lowest))
            axes.annotate(mark.label, place, textcoords="offset points", xytext=(8, 5), fontsize=9)
