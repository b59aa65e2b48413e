"""Plot of lateness: its distribution, and its course second by second, for several runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.report.legends import legend_beside
from lidar_emu.report.png_file import check_plot_path, write_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIZE_INCH = (16.0, 8.0)
_DOTS_PER_INCH = 100
_BINS = 120
_LEAST_US = 1.0


@dataclass(frozen=True)
class LatenessCurve:
    """Lateness of one run."""

    label: str
    lateness_ns: IntArray
    """Lateness of all shots, in any order."""
    at_s: Sequence[int]
    """Start of each window."""
    p99_ns: Sequence[int | None]
    """99th percentile of each window; None for a window without shots."""


def plot_lateness(curves: Sequence[LatenessCurve], title: str, path: Path) -> None:
    """Plot a PNG of 1600 by 800 pixels.

    Args:
        curves: runs to overlay.
        title: title of the figure.
        path: file, `.png`.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    write_png(_draw(curves, title), path)


def _draw(curves: Sequence[LatenessCurve], title: str) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_INCH, dpi=_DOTS_PER_INCH, layout="constrained")
    figure.suptitle(title, fontsize=15)
    spread, seconds = figure.subplots(1, 2)
    _draw_spread(spread, curves)
    _draw_seconds(seconds, curves)
    return figure


def _draw_spread(axes: Axes, curves: Sequence[LatenessCurve]) -> None:
    values_us = [np.maximum(_LEAST_US, curve.lateness_ns / 1e3) for curve in curves]
    bins = _bins(values_us)
    for curve, values in zip(curves, values_us, strict=True):
        axes.hist(values, bins=bins.tolist(), histtype="step", linewidth=1.5, label=curve.label)
    axes.set(xscale="log", yscale="log", xlabel="due to written (us)", ylabel="shots")
    axes.grid(alpha=0.3)


def _bins(values_us: Sequence[FloatArray]) -> FloatArray:
    everything = np.concatenate([*values_us, [10.0]])
    return np.geomspace(everything.min() * 0.99, everything.max() * 1.01, _BINS)


def _draw_seconds(axes: Axes, curves: Sequence[LatenessCurve]) -> None:
    for curve in curves:
        p99_us = [np.nan if value is None else value / 1e3 for value in curve.p99_ns]
        axes.plot(curve.at_s, p99_us, marker=".", linewidth=1, label=curve.label)
    axes.set(yscale="log", xlabel="time (s)", ylabel="p99 of each second, due to written (us)")
    legend_beside(axes)
    axes.grid(alpha=0.3)
