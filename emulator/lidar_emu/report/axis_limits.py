"""Limits of axes that outliers do not widen, and markers at the edge for the points outside."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.report.page_style import beam_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
    mark_outside(axes, f"C{beam % 10}", x, y, limits)


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


def outside_words(count: int) -> str:
    """State in a caption how many values the limits leave out; nothing if none."""
    return f" {count} outside the axes: triangles at the edge." if count else ""
