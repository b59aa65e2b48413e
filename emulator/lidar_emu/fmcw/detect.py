"""Groups of contiguous strong bins in a spectrum."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel

MAX_GROUPS = 4
"""Groups kept of one spectrum, the strongest."""


@kernel
def find_groups(
    power: FloatArray, noise: FloatArray, threshold: float, floor: float, peaks: NDArray[np.int64]
) -> int:
    """Contiguous bins above a floor, with a peak above the threshold.

    Args:
        power: (bins,) with 0 at the end and between intervals that do not touch.
        noise: (bins,) mean power of the noise, in any unit.
        threshold: least power of a group's peak over its noise.
        floor: least power of a group's bins.
        peaks: (MAX_GROUPS,) receives the indices of the groups' highest bins, strongest first.

    Returns:
        The number of groups, MAX_GROUPS at most.
    """
    # No literals, for which numba would compile `_keep` once more.
    count, peak = int(np.int64(0)), int(np.int64(-1))
    for j in range(len(power)):
        if power[j] > floor:
            if peak < 0 or power[j] > power[peak]:
                peak = j
        elif peak >= 0:
            if power[peak] > threshold * noise[peak]:
                count = _keep(power, peak, peaks, count)
            peak = -1
    return count


@kernel
def _keep(power: FloatArray, peak: int, peaks: NDArray[np.int64], count: int) -> int:
    """Put a peak in its place among the `count` strongest; of equals the first stays before."""
    place = count
    while place > 0 and power[peaks[place - 1]] < power[peak]:
        if place < MAX_GROUPS:
            peaks[place] = peaks[place - 1]
        place -= 1
    if place < MAX_GROUPS:
        peaks[place] = peak
    return min(count + 1, MAX_GROUPS)
