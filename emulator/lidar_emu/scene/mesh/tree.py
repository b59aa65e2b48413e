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

WIDTH = 8
"""Maximum number of boxes in a node."""

NODE = np.dtype(
    [("planes_m", np.float32, (6, WIDTH)), ("first", np.int32, (WIDTH,)), ("held", np.int32, (WIDTH,))]
)
"""The boxes within a box: minimum x, y and z, then maximum x, y and z of each, rounded outward; number of a leaf's
triangles, 0 for a box that is divided further; a leaf's first triangle in the order of the tree, or the node of the
boxes within. All boxes of a node are tested at once. Absent boxes have a minimum of infinity."""

_EXTENT = np.dtype([("low_m", np.float64, (3,)), ("high_m", np.float64, (3,)), ("number", np.int64)])
"""Minimum and maximum coordinates of a triangle, and its number before it is ordered."""

_BOX = np.dtype(
    [("low_m", np.float64, (3,)), ("high_m", np.float64, (3,)), ("first", np.int64), ("held", np.int64)]
)
"""A box while the tree is built: minimum and maximum coordinates; the first of its two boxes, or of its triangles; the
number of these, 0 once it is divided."""


class BoxTree(NamedTuple):
    """Boxes over n triangles."""

    nodes: NDArray[np.void]
    """(nodes,) records of `NODE`, the root first."""
    order: IntArray
    """(n,) Order of the triangles, leaf after leaf."""
    depth: int
    """Depth of the tree in nodes."""
    low_m: FloatArray
    """(3,) Minimum coordinates of all triangles."""
    high_m: FloatArray
    """(3,) Maximum coordinates."""


def build_tree(low_m: FloatArray, high_m: FloatArray) -> BoxTree:
    """Build the tree over triangles with minimum and maximum coordinates (n, 3), n > 0."""
    count = len(low_m)
    extents = with_fields(np.empty(count, dtype=_EXTENT))
    extents["low_m"], extents["high_m"] = low_m - MARGIN_M, high_m + MARGIN_M
    extents["number"] = np.arange(count)
    boxes = with_fields(np.zeros(2 * count + 1, dtype=_BOX))
    bins, right = np.empty((3, _BINS, 7)), np.empty(_BINS)
    used = _split_all(extents, boxes, bins, right)
    nodes, depth = with_fields(np.zeros(used, dtype=NODE)), np.zeros(used, dtype=np.int64)
    children = np.empty(WIDTH, dtype=np.int64)
    node_count = _gather_all(boxes[:used], nodes, depth, children)
    return BoxTree(
        nodes[:node_count].copy(),
        extents["number"].copy(),
        int(depth[:node_count].max()) + 1,
        boxes["low_m"][0].copy(),
        boxes["high_m"][0].copy(),
    )


@kernel(outermost=True)
def _split_all(
    extents: NDArray[np.void],
    boxes: NDArray[np.void],
    bins: FloatArray,
    right: FloatArray,
) -> int:
    used, node = 1, 0
    boxes[0].first, boxes[0].held = 0, extents.shape[0]
    while node < used:
        box = boxes[node]
        start, count = box.first, box.held
        within = extents[start : start + count]
        _enclose(within, box)
        if count > LEAF_TRIANGLES:
            middle = start + _split(within, bins, right)
            boxes[used].first, boxes[used].held = start, middle - start
            boxes[used + 1].first, boxes[used + 1].held = middle, start + count - middle
            box.first, box.held = used, 0
            used += 2
        node += 1
    return used


@kernel
def _enclose(extents: NDArray[np.void], box: Any) -> None:
    for axis in range(3):
        box.low_m[axis], box.high_m[axis] = np.inf, -np.inf
    for k in range(extents.shape[0]):
        _widen(box.low_m, box.high_m, extents[k].low_m, extents[k].high_m)


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
def _split(extents: NDArray[np.void], bins: FloatArray, right: FloatArray) -> int:
    count: int = extents.shape[0]
    least, scale = _spread(extents)
    _fill_bins(extents, least, scale, bins)
    best_axis, best_bin, best_work = -1, 0, np.inf
    for axis in range(3):
        if scale[axis] < np.inf:
            place, work = _best_place(count, bins[axis], right)
            if work < best_work:
                best_axis, best_bin, best_work = axis, place, work
    if best_axis < 0:
        # All centres coincide.
        return count // 2
    i, j = 0, count - 1
    while i <= j:
        if _bin_of(extents[i], best_axis, least[best_axis], scale[best_axis]) <= best_bin:
            i += 1
        else:
            _swap(extents[i], extents[j])
            j -= 1
    return i


@kernel
def _spread(extents: NDArray[np.void]) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Least centre of the triangles along each axis, twice, and bins per unit of twice a centre; infinity where all
    centres coincide."""
    x0 = y0 = z0 = np.inf
    x1 = y1 = z1 = -np.inf
    for k in range(extents.shape[0]):
        low, high = extents[k].low_m, extents[k].high_m
        x, y, z = low[0] + high[0], low[1] + high[1], low[2] + high[2]
        x0, x1 = min(x0, x), max(x1, x)
        y0, y1 = min(y0, y), max(y1, y)
        z0, z1 = min(z0, z), max(z1, z)
    return (x0, y0, z0), (_per_bin(x0, x1), _per_bin(y0, y1), _per_bin(z0, z1))


@kernel
def _per_bin(least: float, most: float) -> float:
    return _BINS / (most - least) if most > least else np.inf


@kernel
def _bin_of(extent: Any, axis: int, least: float, scale: float) -> int:
    centre = extent.low_m[axis] + extent.high_m[axis]
    return min(int((centre - least) * scale), _BINS - 1)


@kernel
def _fill_bins(
    extents: NDArray[np.void],
    least: tuple[float, float, float],
    scale: tuple[float, float, float],
    bins: FloatArray,
) -> None:
    bins[:, :, :3], bins[:, :, 3:6], bins[:, :, 6] = np.inf, -np.inf, 0.0
    for k in range(extents.shape[0]):
        extent = extents[k]
        for axis in range(3):
            if scale[axis] < np.inf:
                held = bins[axis, _bin_of(extent, axis, least[axis], scale[axis])]
                _widen(held[:3], held[3:6], extent.low_m, extent.high_m)
                held[6] += 1.0


@kernel
def _swap(one: Any, other: Any) -> None:
    one.number, other.number = other.number, one.number
    for axis in range(3):
        one.low_m[axis], other.low_m[axis] = other.low_m[axis], one.low_m[axis]
        one.high_m[axis], other.high_m[axis] = other.high_m[axis], one.high_m[axis]


@kernel
def _best_place(count: int, bins: FloatArray, right: FloatArray) -> tuple[int, float]:
    """Bin after which to divide, and the remaining work; the first and the last bin contain triangles."""
    place, work = 0, np.inf
    # From the right first, then from the left; the last and the first bin serve as the growing boxes.
    for b in range(_BINS - 1, 0, -1):
        if b < _BINS - 1:
            _widen_by_bin(bins, _BINS - 1, b)
        right[b] = _half_area(bins[_BINS - 1, :3], bins[_BINS - 1, 3:6]) * bins[_BINS - 1, 6]
    for b in range(_BINS - 1):
        if b > 0:
            _widen_by_bin(bins, 0, b)
        if bins[0, 6] < count:
            left = _half_area(bins[0, :3], bins[0, 3:6]) * bins[0, 6]
            if left + right[b + 1] < work:
                place, work = b, left + right[b + 1]
    return place, work


@kernel
def _widen_by_bin(bins: FloatArray, wider: int, b: int) -> None:
    _widen(bins[wider, :3], bins[wider, 3:6], bins[b, :3], bins[b, 3:6])
    bins[wider, 6] += bins[b, 6]


@kernel(outermost=True)
def _gather_all(boxes: NDArray[np.void], nodes: NDArray[np.void], depth: IntArray, children: IntArray) -> int:
    """Fill nodes of up to `WIDTH` boxes from boxes of two each; returns the number of nodes.

    Args:
        depth: (nodes,) receives the number of nodes above each.
        children: (WIDTH,) overwritten.
    """
    # Until its own turn a node holds in `first` the box that it divides.
    used, node = 1, 0
    nodes[0].first[0] = 0
    while node < used:
        own = nodes[node]
        count = _gather(boxes, own.first[0], children)
        for c in range(WIDTH):
            own.planes_m[:3, c], own.planes_m[3:, c] = np.inf, -np.inf
            own.first[c] = own.held[c] = 0
        for c in range(count):
            box = boxes[children[c]]
            for axis in range(3):
                own.planes_m[axis, c] = -_not_below(-box.low_m[axis])
                own.planes_m[3 + axis, c] = _not_below(box.high_m[axis])
            own.first[c], own.held[c] = box.first, box.held
            if box.held == 0:
                own.first[c], nodes[used].first[0], depth[used] = used, children[c], depth[node] + 1
                used += 1
        node += 1
    return used


@kernel
def _gather(boxes: NDArray[np.void], box: int, children: IntArray) -> int:
    """Choose the boxes that a node has in place of `box`, the largest opened first; returns their number."""
    children[0] = box
    count = 1
    while count < WIDTH:
        largest, area = -1, -1.0
        for c in range(count):
            child = boxes[children[c]]
            if child.held == 0 and _half_area(child.low_m, child.high_m) > area:
                largest, area = c, _half_area(child.low_m, child.high_m)
        if largest < 0:
            break
        first = boxes[children[largest]].first
        children[largest], children[count] = first, first + 1
        count += 1
    return count


@kernel
def _not_below(value: float) -> float:
    """The number, or slightly more, in single precision."""
    rounded = np.float32(value)
    if np.float64(rounded) < value:
        rounded = np.nextafter(rounded, np.float32(np.inf))
    return np.float64(rounded)
