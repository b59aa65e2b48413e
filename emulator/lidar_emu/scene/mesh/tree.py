"""A tree of boxes over triangles, by which a ray passes over all but a few of them.

Each box that holds many triangles is split in two across the axis and at the place that make the least work for a ray:
the least sum of areas times triangles over a few places (the surface area heuristic).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel

LEAF_TRIANGLES = 4
"""A box of no more is not split."""

MARGIN_M = 1e-9
"""By how much boxes are larger than what they hold: more than the rounding of a contact up to 1000 km away."""

_BINS = 16
"""Places between which a split is looked for, along each axis."""


class BoxTree(NamedTuple):
    """Boxes, the root first; the two halves of a box lie side by side."""

    box: FloatArray
    """(boxes, 6) least x, y, z, then greatest."""
    first: IntArray
    """(boxes,) first of the two halves; of a leaf its first triangle in `order`."""
    held: IntArray
    """(boxes,) triangles of a leaf; 0 for a box that is split."""
    order: IntArray
    """(triangles,) the triangles, leaf after leaf."""
    depth: int
    """Boxes on the longest way down."""


def build_tree(low: FloatArray, high: FloatArray) -> BoxTree:
    """The tree over triangles whose least and greatest corners are (n, 3), n > 0."""
    count = len(low)
    box, order = np.empty((2 * count, 6)), np.arange(count, dtype=np.int64)
    first, held, depth = (np.zeros(2 * count, dtype=np.int64) for _ in range(3))
    bins, right = np.empty((_BINS, 7)), np.empty(_BINS)
    boxes = _split_all(low - MARGIN_M, high + MARGIN_M, order, box, first, held, depth, bins, right)
    return BoxTree(
        box[:boxes].copy(), first[:boxes].copy(), held[:boxes].copy(), order, int(depth[:boxes].max()) + 1
    )


@kernel(outermost=True)
def _split_all(
    low: FloatArray,
    high: FloatArray,
    order: IntArray,
    box: FloatArray,
    first: IntArray,
    count: IntArray,
    depth: IntArray,
    bins: FloatArray,
    right: FloatArray,
) -> int:
    """Fill the arrays of a `BoxTree`; the number of boxes."""
    boxes, node = 1, 0
    first[0], count[0] = 0, order.shape[0]
    while node < boxes:
        start, end = first[node], first[node] + count[node]
        _enclose(low, high, order, start, end, box[node])
        if count[node] > LEAF_TRIANGLES:
            middle = _split(low, high, order, start, end, bins, right)
            first[boxes], count[boxes] = start, middle - start
            first[boxes + 1], count[boxes + 1] = middle, end - middle
            depth[boxes] = depth[boxes + 1] = depth[node] + 1
            first[node], count[node] = boxes, 0
            boxes += 2
        node += 1
    return boxes


@kernel
def _enclose(
    low: FloatArray, high: FloatArray, order: IntArray, start: int, end: int, box: FloatArray
) -> None:
    for axis in range(3):
        box[axis], box[3 + axis] = np.inf, -np.inf
    for k in range(start, end):
        _widen(box, low[order[k]], high[order[k]])


@kernel
def _widen(box: FloatArray, low: FloatArray, high: FloatArray) -> None:
    for axis in range(3):
        box[axis] = min(box[axis], low[axis])
        box[3 + axis] = max(box[3 + axis], high[axis])


@kernel
def _half_area(box: FloatArray) -> float:
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    area: float = x * y + y * z + z * x
    return area


@kernel
def _split(
    low: FloatArray,
    high: FloatArray,
    order: IntArray,
    start: int,
    end: int,
    bins: FloatArray,
    right: FloatArray,
) -> int:
    """Order triangles so that those up to the number returned are one half, and the rest the other."""
    best_axis, best_bin, best_work = -1, 0, np.inf
    best_from, best_scale = 0.0, 0.0
    for axis in range(3):
        least, most = np.inf, -np.inf
        for k in range(start, end):
            centre = low[order[k], axis] + high[order[k], axis]
            least, most = min(least, centre), max(most, centre)
        scale = _BINS / (most - least) if most > least else np.inf
        if not scale < np.inf:
            continue
        place, work = _best_place(low, high, order, start, end, axis, least, scale, bins, right)
        if work < best_work:
            best_axis, best_bin, best_work, best_from, best_scale = axis, place, work, least, scale
    if best_axis < 0:
        # They all lie about the same point.
        return (start + end) // 2
    i, j = start, end - 1
    while i <= j:
        triangle = order[i]
        if _bin_of(low, high, triangle, best_axis, best_from, best_scale) <= best_bin:
            i += 1
        else:
            order[i], order[j] = order[j], triangle
            j -= 1
    return i


@kernel
def _bin_of(low: FloatArray, high: FloatArray, triangle: int, axis: int, least: float, scale: float) -> int:
    return min(int((low[triangle, axis] + high[triangle, axis] - least) * scale), _BINS - 1)


@kernel
def _best_place(
    low: FloatArray,
    high: FloatArray,
    order: IntArray,
    start: int,
    end: int,
    axis: int,
    least: float,
    scale: float,
    bins: FloatArray,
    right: FloatArray,
) -> tuple[int, float]:
    """The bin after which to split, and the work that is left; the first and the last bin hold triangles."""
    for b in range(_BINS):
        bins[b, :3], bins[b, 3:6], bins[b, 6] = np.inf, -np.inf, 0.0
    for k in range(start, end):
        triangle = order[k]
        b = _bin_of(low, high, triangle, axis, least, scale)
        _widen(bins[b], low[triangle], high[triangle])
        bins[b, 6] += 1.0
    place, work = 0, np.inf
    # From the right first, then from the left: the last bin and the first become the boxes that grow.
    for b in range(_BINS - 1, 0, -1):
        if b < _BINS - 1:
            _widen_by_bin(bins, _BINS - 1, b)
        right[b] = _half_area(bins[_BINS - 1]) * bins[_BINS - 1, 6]
    for b in range(_BINS - 1):
        if b > 0:
            _widen_by_bin(bins, 0, b)
        if bins[0, 6] < end - start:
            left = _half_area(bins[0]) * bins[0, 6]
            if left + right[b + 1] < work:
                place, work = b, left + right[b + 1]
    return place, work


@kernel
def _widen_by_bin(bins: FloatArray, wider: int, b: int) -> None:
    _widen(bins[wider], bins[b, :3], bins[b, 3:6])
    bins[wider, 6] += bins[b, 6]
