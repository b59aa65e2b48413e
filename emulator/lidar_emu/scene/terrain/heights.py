"""Heights of an elevation grid: their range and steps, and numbers that cannot be heights."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel

LARGEST_M = 1e8
"""Larger than the radius of any planet, from whose centre the heights of some files count."""
_MARKERS = (-32768.0, -32767.0, -9999.0, -99999.0, 32767.0, 65535.0)
"""Numbers that commonly mark missing samples."""
_APART = 0.01
"""A marker lies further from all heights than this fraction of their range; a height of that value does not."""


class HeightRange(NamedTuple):
    """Range of the heights of a grid; NaN where there are none."""

    lowest_m: float
    highest_m: float
    step_m: float
    """Largest difference of neighbours in a row or a column."""

    def __str__(self) -> str:
        low_m, high_m = (round(height_m, 2) for height_m in (self.lowest_m, self.highest_m))
        return f"heights {low_m:.7g} to {high_m:.7g} m, largest step {self.step_m:.3g} m"


def height_range(elevation_m: FloatArray) -> HeightRange:
    """Measure a grid (rows, columns) in which missing samples are NaN."""
    low, high, step_m = _extremes(np.ascontiguousarray(elevation_m))
    if low < 0:
        return HeightRange(np.nan, np.nan, np.nan)
    return HeightRange(float(elevation_m.flat[low]), float(elevation_m.flat[high]), step_m)


def check_heights(
    where: str, stored: npt.NDArray[np.generic], elevation_m: FloatArray, marker: float | None
) -> None:
    """Refuse numbers that mark missing samples without being stated as such, and heights beyond any body.

    Args:
        where: the file.
        stored: (rows, columns) numbers of the file.
        elevation_m: (rows, columns) the same in metres, NaN where missing.
        marker: the number that the site states for missing samples.
    """
    low, high, _ = _extremes(elevation_m)
    if low < 0:
        return
    for place in (low, high):
        number, height_m = float(stored.flat[place]), elevation_m.flat[place]
        if marker is None and number in _MARKERS and _stands_apart(number, stored[~np.isnan(elevation_m)]):
            found = f"{(stored == number).sum()} samples of {number:g}, which commonly marks missing ones"
            remedy = (
                f"state ground.nodata: {number:g} if they are missing, another number if they are heights"
            )
            raise InputError(where, None, Finding(found), remedy)
        if abs(height_m) > LARGEST_M:
            remedy = (
                f"state ground.nodata: {number!r} if such samples are missing, or a ground.elevation_scale"
            )
            raise InputError(where, None, Finding(f"a height of {height_m:.6g} m"), remedy)


@kernel
def _extremes(elevation_m: FloatArray) -> tuple[int, int, float]:
    """Places of the lowest and of the highest sample in the flattened grid, -1 if all are missing, and the largest
    step; NaN if no neighbours are known."""
    rows, columns = elevation_m.shape
    lowest, highest, step = -1, -1, -1.0
    low, high = np.inf, -np.inf
    for row in range(rows):
        for column in range(columns):
            here = elevation_m[row, column]
            if here < low:
                low, lowest = here, row * columns + column
            if here > high:
                high, highest = here, row * columns + column
            # Comparisons with NaN are false.
            if row and abs(here - elevation_m[row - 1, column]) > step:
                step = abs(here - elevation_m[row - 1, column])
            if column and abs(here - elevation_m[row, column - 1]) > step:
                step = abs(here - elevation_m[row, column - 1])
    return lowest, highest, step if step >= 0.0 else np.nan


def _stands_apart(number: float, heights: npt.NDArray[np.generic]) -> bool:
    """Whether a number is far from all others; also if there are no others."""
    others = heights[heights != number].astype(np.float64)
    if not others.size:
        return True
    low, high = float(others.min()), float(others.max())
    return min(abs(number - low), abs(number - high)) > max(_APART * (high - low), 1.0)
