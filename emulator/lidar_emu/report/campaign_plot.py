"""Plot of a campaign: dropout rate and errors by altitude and incidence angle, with confidence bands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.png_file import check_plot_path, write_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SIZE_INCH = (16.0, 12.0)
_DOTS_PER_INCH = 100


@dataclass(frozen=True)
class CampaignColumn:
    """Data of one column of panels. The last axis of each array of estimates is (value, low, high)."""

    label: str
    logarithmic: bool
    edge: FloatArray
    """(bands, 2) Lower and upper edge."""
    dropout: FloatArray
    """(bands, 3)"""
    quantiles: dict[str, FloatArray]
    """Quantiles (levels, bands, 3) by the label of the error."""


def plot_campaign(columns: Sequence[CampaignColumn], levels: Sequence[str], title: str, path: Path) -> None:
    """Plot a PNG of 1600 by 1200 pixels: a column per axis; dropout rate above, quantiles of errors below.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_INCH, dpi=_DOTS_PER_INCH, layout="constrained")
    figure.suptitle(title, fontsize=15)
    rows = 1 + max(len(column.quantiles) for column in columns)
    panels = figure.subplots(rows, len(columns), sharex="col", squeeze=False)
    for j, column in enumerate(columns):
        _draw_dropout(panels[0, j], column)
        for axes, (label, quantiles) in zip(panels[1:, j], column.quantiles.items(), strict=True):
            _draw_errors(axes, column, label, quantiles, levels)
        panels[-1, j].set_xlabel(column.label)
    write_png(figure, path)


def _draw_dropout(axes: Axes, column: CampaignColumn) -> None:
    _draw_bands(axes, column, 100.0 * column.dropout, "C3", None)
    largest = float(np.nanmax(column.dropout[:, 0], initial=0.0))
    axes.set(ylabel="without a valid range (%)", ylim=(0.0, 160.0 * largest or 1.0))


def _draw_errors(
    axes: Axes, column: CampaignColumn, label: str, quantiles: FloatArray, levels: Sequence[str]
) -> None:
    for i, level in enumerate(levels):
        _draw_bands(axes, column, quantiles[i], f"C{i}", level)
    # Bands of mostly false locks, with errors of kilometres, must not set the scale.
    known = np.abs(quantiles[:, :, 0][np.isfinite(quantiles[:, :, 0])])
    largest = float(np.percentile(known, 90)) if known.size else 0.0
    axes.set(ylabel=label, ylim=(-1.8 * largest, 1.8 * largest) if largest > 0 else None)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), frameon=False)


def _draw_bands(
    axes: Axes, column: CampaignColumn, estimate: FloatArray, colour: str, label: str | None
) -> None:
    low, high = column.edge.T
    middle = np.sqrt(low * high) if column.logarithmic else (low + high) / 2
    value, least, most = estimate.T
    axes.fill_between(middle, least, most, color=colour, alpha=0.25, linewidth=0)
    axes.plot(middle, value, color=colour, marker=".", linewidth=1.2, label=label)
    if column.logarithmic:
        axes.set_xscale("log")
    axes.grid(alpha=0.3)
