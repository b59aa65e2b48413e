"""A tree of boxes over triangles, by which a ray skips all but a few of them.

A box with many triangles is divided along the axis and at the position with the least expected work for a ray: the
least sum of areas times triangle counts over a few candidate positions (the surface area heuristic).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel, with_fields

LEAF_TRIANGLES = 4
"""Maximum number of triangles in a leaf."""

MARGIN_M = 1e-9
"""Margin of the boxes: more than the rounding of a contact up to 1000 km away."""

_BINS = 16
"""Number of candidate positions of a division, along each axis."""


BOX = np.dtype(
    [("low_m", np.float64, (3,)), ("high_m", np.float64, (3,)), ("first", np.int64), ("held", np.int64)]
)
"""A box: minimum and maximum x, y and z; index of the first of its two children, or of a leaf's first triangle in the
order of the tree; number of triangles of a leaf, 0 for an inner box."""


class BoxTree(NamedTuple):
    """Boxes, the root first; the two children of a box are adjacent."""

    boxes: NDArray[np.void]
    """(boxes,) records of `BOX`."""
    order: IntArray
    """(triangles,) Order of the triangles, leaf after leaf."""
    depth: int
    """Depth of the tree in boxes."""


class _Extents(NamedTuple):
    """Extents of triangles while the tree is built."""

    low: FloatArray
    """(triangles, 3) Minimum coordinates."""
    high: FloatArray
    """(triangles, 3) Maximum coordinates."""
    order: IntArray
    """(triangles,) Order of the triangles so far."""


def build_tree(low: FloatArray, high: FloatArray) -> BoxTree:
    """Build the tree over triangles with minimum and maximum coordinates (n, 3), n > 0."""
    count = len(low)
    boxes, order = with_fields(np.zeros(2 * count, dtype=BOX)), np.arange(count, dtype=np.int64)
    depth = np.zeros(2 * count, dtype=np.int64)
    bins, right = np.empty((_BINS, 7)), np.empty(_BINS)
    used = _split_all(low - MARGIN_M, high + MARGIN_M, order, boxes, depth, bins, right)
    return BoxTree(boxes[:used].copy(), order, int(depth[:used].max()) + 1)


@kernel(outermost=True)
def _split_all(
    low: FloatArray,
    high: FloatArray,
    order: IntArray,
    boxes: NDArray[np.void],
    depth: IntArray,
    bins: FloatArray,
    right: FloatArray,
) -> int:
    """Fill the arrays of a `BoxTree`; returns the number of boxes."""
    extents = _Extents(low, high, order)
    used, node = 1, 0
    boxes[0].first, boxes[0].held = 0, order.shape[0]
    while node < used:
        box = boxes[node]
        start, count = box.first, box.held
        _enclose(extents, start, start + count, box)
        if count > LEAF_TRIANGLES:
            middle = _split(extents, start, start + count, bins, right)
            boxes[used].first, boxes[used].held = start, middle - start
            boxes[used + 1].first, boxes[used + 1].held = middle, start + count - middle
            depth[used] = depth[used + 1] = depth[node] + 1
            box.first, box.held = used, 0
            used += 2
        node += 1
    return used


@kernel
def _enclose(extents: _Extents, start: int, end: int, box: Any) -> None:
    for axis in range(3):
        box.low_m[axis], box.high_m[axis] = np.inf, -np.inf
    for k in range(start, end):
        triangle = extents.order[k]
        _widen(box.low_m, box.high_m, extents.low[triangle], extents.high[triangle])


@kernel
def _widen(box_low: FloatArray, box_high: FloatArray, low: FloatArray, high: FloatArray) -> None:
    for axis in range(3):
        box_low[axis] = min(box_low[axis], low[axis])
        box_high[axis] = max(box_high[axis], high[axis])


@kernel
def _half_area(low: FloatArray, high: FloatArray) -> float:
    x, y, z = high[0] - low[0], high[1] - low[1], high[2] - low[2]
    area: float = x * y + y * z + z * x
    return area


@kernel
def _split(extents: _Extents, start: int, end: int, bins: FloatArray, right: FloatArray) -> int:
    """Reorder triangles into two halves; returns the index at which the second half begins."""
    low, high, order = extents
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
        place, work = _best_place(extents, start, end, axis, least, scale, bins, right)
        if work < best_work:
            best_axis, best_bin, best_work, best_from, best_scale = axis, place, work, least, scale
    if best_axis < 0:
        # All centres coincide.
        return (start + end) // 2
    i, j = start, end - 1
    while i <= j:
        triangle = order[i]
        if _bin_of(extents, triangle, best_axis, best_from, best_scale) <= best_bin:
            i += 1
        else:
            order[i], order[j] = order[j], triangle
            j -= 1
    return i


@kernel
def _bin_of(extents: _Extents, triangle: int, axis: int, least: float, scale: float) -> int:
    centre = extents.low[triangle, axis] + extents.high[triangle, axis]
    return min(int((centre - least) * scale), _BINS - 1)


@kernel
def _best_place(
    extents: _Extents,
    start: int,
    end: int,
    axis: int,
    least: float,
    scale: float,
    bins: FloatArray,
    right: FloatArray,
) -> tuple[int, float]:
    """Bin after which to divide, and the remaining work; the first and the last bin contain triangles."""
    for b in range(_BINS):
        bins[b, :3], bins[b, 3:6], bins[b, 6] = np.inf, -np.inf, 0.0
    for k in range(start, end):
        triangle = extents.order[k]
        b = _bin_of(extents, triangle, axis, least, scale)
        _widen(bins[b, :3], bins[b, 3:6], extents.low[triangle], extents.high[triangle])
        bins[b, 6] += 1.0
    place, work = 0, np.inf
    # From the right first, then from the left; the last and the first bin serve as the growing boxes.
    for b in range(_BINS - 1, 0, -1):
        if b < _BINS - 1:
            _widen_by_bin(bins, _BINS - 1, b)
        right[b] = _half_area(bins[_BINS - 1, :3], bins[_BINS - 1, 3:6]) * bins[_BINS - 1, 6]
    for b in range(_BINS - 1):
        if b > 0:
            _widen_by_bin(bins, 0, b)
        if bins[0, 6] < end - start:
            left = _half_area(bins[0, :3], bins[0, 3:6]) * bins[0, 6]
            if left + right[b + 1] < work:
                place, work = b, left + right[b + 1]
    return place, work


@kernel
def _widen_by_bin(bins: FloatArray, wider: int, b: int) -> None:
    _widen(bins[wider, :3], bins[wider, 3:6], bins[b, :3], bins[b, 3:6])
    bins[wider, 6] += bins[b, 6]
