"""Errors of ranges and closing speeds in the units of figures, with the stated sigma."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.report.axis_limits import Limits, error_limits
from lidar_emu.report.page_style import GRID

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BAND_POINTS = 240
_LEAST_RANGE_ERROR_M, _LEAST_SPEED_ERROR_MMPS = 0.01, 0.1
"""Least half width of the axes of errors: errors of a receiver without any are rounding."""


class ErrorValues(NamedTuple):
    """Errors of one quantity, arrays of (shots, beams) in `unit`."""

    quantity: str
    unit: str
    error: FloatArray
    sigma: FloatArray
    """Stated standard deviation; NaN where none is stated."""
    valid: BoolArray
    least: float
    """Least half width of the axis."""

    @property
    def label(self) -> str:
        """Label of an axis."""
        return f"{self.quantity} error ({self.unit})"

    def limits(self) -> Limits:
        """Compute the limits of the axis, which contain two stated sigma."""
        stated = self.sigma[self.valid & np.isfinite(self.sigma)]
        band = 2.0 * float(np.median(stated)) if stated.size else 0.0
        return error_limits(self.error[self.valid], max(band, self.least))

    def outside(self) -> int:
        """Count the errors beyond the limits."""
        error = self.error[self.valid]
        return int(np.count_nonzero(np.isfinite(error) & ~self.limits().contain(error)))


def error_values(measurement: Measurement) -> tuple[ErrorValues, ErrorValues]:
    """Compute the errors of range in m and of closing speed in mm/s."""
    return (
        ErrorValues(
            "range",
            "m",
            measurement.range_m - measurement.true_range_m,
            measurement.sigma_range_m,
            measurement.range_valid,
            _LEAST_RANGE_ERROR_M,
        ),
        ErrorValues(
            "speed",
            "mm/s",
            1e3 * (measurement.closing_speed_mps - measurement.true_closing_speed_mps),
            1e3 * measurement.sigma_speed_mps,
            measurement.speed_valid,
            _LEAST_SPEED_ERROR_MMPS,
        ),
    )


def add_sigma_band(axes: Axes, time_s: FloatArray, sigma: FloatArray) -> None:
    """Draw twice the median of the stated sigma, interval by interval; nothing if none is stated."""
    stated: BoolArray = np.isfinite(sigma) & (sigma > 0.0)
    if not stated.any():
        return
    time_s, sigma = time_s[stated], sigma[stated]
    order = np.argsort(time_s, kind="stable")
    parts = np.array_split(order, min(_BAND_POINTS, len(order)))
    middle_s = np.array([np.median(time_s[part]) for part in parts])
    twice = 2.0 * np.array([np.median(sigma[part]) for part in parts])
    axes.fill_between(
        middle_s, -twice, twice, color=GRID, alpha=0.3, linewidth=0, label="2 stated sigma", zorder=0
    )
