"""A hazard map from the points of a flight: height, slope, roughness, and the probability that a lander stands safely.

As in ALHAT's hazard detection, slope and roughness are those of the plane through the heights under a lander's
footprint, and the noise of the heights makes them random (Ivanov, Huertas and Carson, AIAA 2013-5019). A point does not
tell the height of its whole cell, so heights between points are predicted (after Tomita and Ho, AAS 23-391).
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.signal import fftconvolve
from scipy.special import ndtr

from lidar_emu.files import whole_file
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.report.ground_survey import check_raster_path, geotiff
from lidar_emu.report.hazards import CELL_M, Cloud, Heights, last_of_cells, predict_heights

MAP_SUFFIXES = (".tif", ".npz")
_MOST_HALF_M = 60.0
"""Half of the longest side of a map, about the median of the points."""
LEAST_CELLS = 8
"""Least number of cells with a point under a footprint."""
_LEAST_SPREAD = 0.2
"""Least ratio of their spread across and along the line through them: points on a line determine no slope."""
_MOST_ASIDE = 0.25
"""Largest distance of their centre from the footprint's, in radii: planes are not extrapolated."""
_LEAST_SIGMA_M = 1e-3
_PLACES_AT_ONCE = 1 << 21
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
_SIGMAS = 8.0
"""Reach of an integral over a Gaussian."""
_LEAST_WEIGHT = 1e-4
_SIDE_M = CELL_M / 2 * np.array([-1, 0, 1])
PLACES_M = np.stack(np.meshgrid(_SIDE_M, _SIDE_M), axis=-1).reshape(-1, 2)
"""(9, 2) Places of a cell at which heights are compared with the plane, from its centre: also its edges and corners."""
_INDEPENDENT = 2.0
"""How many independent places the places of a cell are worth, from flights over boulders."""


class Lander(NamedTuple):
    """What a lander needs to stand safely."""

    footprint_m: float = 10.0
    """Diameter of the circle of its feet."""
    slope_deg: float = 10.0
    """Largest slope of the plane through the ground below."""
    step_m: float = 0.3
    """Largest height off that plane, up or down."""


class HazardMap(NamedTuple):
    """A map in the site frame: arrays (rows, columns), rows to the north; NaN where the points do not tell."""

    lander: Lander
    east_m: FloatArray
    """(columns,) East of the cells' centres."""
    north_m: FloatArray
    """(rows,) North of the cells' centres."""
    height_m: FloatArray
    """Height of the last point in the cell above the origin; NaN without a point."""
    slope_deg: FloatArray
    """Slope of the plane through the heights under the footprint about the cell."""
    roughness_m: FloatArray
    """Largest distance of these heights from that plane."""
    safe_probability: FloatArray
    """Probability that slope and roughness of the ground under the footprint are within the lander's limits."""


def slope_within(gradient: FloatArray, covariance: FloatArray, slope_deg: float) -> FloatArray:
    """(n,) Probability that the length of a Gaussian gradient, (n, 2) with covariance (n, 2, 2), is below a slope.

    Exact along the gradient, by Gauss-Legendre quadrature of an angle across it.
    """
    limit = np.tan(np.radians(slope_deg))
    length = np.linalg.norm(gradient, axis=-1)
    along = np.where(length[:, None] > 0, gradient / np.maximum(length, 1e-300)[:, None], [1.0, 0.0])
    across = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    rr, rt, tt = (
        np.einsum("ni,nij,nj->n", a, covariance, b)
        for a, b in ((along, along), (along, across), (across, across))
    )
    reach = np.minimum(limit, _SIGMAS * np.sqrt(tt))[:, None]
    angle = np.pi / 2 * _NODES
    t = reach * np.sin(angle)
    mean = length[:, None] + (rt / tt)[:, None] * t
    own = np.sqrt(np.maximum(rr - rt**2 / tt, 1e-300))[:, None]
    half = np.sqrt(np.maximum(limit**2 - t**2, 0.0))
    inside = ndtr((half - mean) / own) - ndtr((-half - mean) / own)
    density = np.exp(-(t**2) / (2 * tt[:, None])) / np.sqrt(2 * np.pi * tt)[:, None]
    return np.asarray((inside * density * reach * np.cos(angle)) @ _WEIGHTS * np.pi / 2)


class Planes(NamedTuple):
    """Planes through the heights under footprints, (n,), and heights off them, (n, cells of a footprint, places)."""

    footprint: IntArray
    """Footprints whose heights determine a plane, as flat indices of the map."""
    cells: IntArray
    """(n, cells of a footprint) Flat indices of the cells of the map with its margin."""
    gradient: FloatArray
    """(n, 2) To the east and to the north."""
    covariance: FloatArray
    """(n, 2, 2)"""
    off_m: FloatArray
    """NaN in cells without a height."""

    @property
    def slope_deg(self) -> FloatArray:
        return np.asarray(np.degrees(np.arctan(np.linalg.norm(self.gradient, axis=-1))))

    @property
    def roughness_m(self) -> FloatArray:
        return np.asarray(np.nanmax(np.abs(self.off_m), axis=(1, 2), initial=0.0))


def fit_planes(height_m: FloatArray, sigma_m: FloatArray, footprint_m: float) -> Iterator[Planes]:
    """Fit planes by least squares to the heights under the footprint about each cell.

    Args:
        height_m: (rows + 2 m, columns + 2 m, places) heights at the places of the cells of the map and of a margin of
            `margin_cells`; NaN: unknown.
        sigma_m: (rows + 2 m, columns + 2 m) standard deviation that the places of a cell share.
        footprint_m: diameter of the footprint.

    Yields:
        The planes of some footprints at a time.
    """
    margin, (rows, columns) = margin_cells(footprint_m), sigma_m.shape
    inside = footprint_cells(footprint_m)
    east, north = np.meshgrid(*(np.arange(-margin, margin + 1),) * 2)
    centre_m = CELL_M * np.column_stack([east[inside], north[inside]])
    design, cell = (
        np.concatenate([np.ones((*at_m.shape[:-1], 1)), at_m], axis=-1)
        for at_m in (centre_m[:, None] + PLACES_M, centre_m)
    )
    squares = np.einsum("kpi,kpj->kij", design, design).reshape(-1, 9)
    of_cells = np.einsum("ki,kj->kij", cell, cell).reshape(-1, 9)
    offset = (north * columns + east)[inside]
    row, column = np.arange(margin, rows - margin), np.arange(margin, columns - margin)
    centre = (row[:, None] * columns + column).ravel()
    up_m, variance = height_m.reshape(-1, len(PLACES_M)), sigma_m.ravel() ** 2
    at_once = _PLACES_AT_ONCE // (len(PLACES_M) * len(offset))
    for first in range(0, len(centre), at_once):
        cells = centre[first : first + at_once, None] + offset
        seen = np.isfinite(up_m[cells, 0])
        index = np.flatnonzero(_determined(seen, of_cells, _MOST_ASIDE * footprint_m / 2))
        if not index.size:
            continue
        cells, seen = cells[index], seen[index]
        own_m = up_m[cells]
        own_m -= np.nanmean(own_m, axis=(1, 2), keepdims=True)
        inverse = np.linalg.inv((seen @ squares).reshape(-1, 3, 3))
        moment = np.tensordot(np.nan_to_num(own_m), design, 2)
        plane = np.einsum("nij,nj->ni", inverse, moment)
        off_m = own_m - np.tensordot(plane, design, (1, 2))
        noise = (len(PLACES_M) ** 2 * np.where(seen, variance[cells], 0.0) @ of_cells).reshape(-1, 3, 3)
        covariance = inverse @ noise @ inverse
        yield Planes(first + index, cells, plane[:, 1:], covariance[:, 1:, 1:], off_m)


def margin_cells(footprint_m: float) -> int:
    """Cells beyond the map that the footprints at its edge reach."""
    return int(footprint_m / 2 / CELL_M) + 1


def footprint_cells(footprint_m: float) -> BoolArray:
    """Cells under a footprint, in a square of them with the margin."""
    beside = np.arange(2 * margin_cells(footprint_m) + 1) - margin_cells(footprint_m)
    return np.asarray(np.hypot(beside[:, None], beside) * CELL_M <= footprint_m / 2)


def _determined(seen: BoolArray, squares: FloatArray, aside_m: float) -> BoolArray:
    """Whether the cells seen, (n, cells), are enough, about the middle, and no line."""
    count, x, y, _, xx, xy, _, _, yy = (seen @ squares).T
    x, y, xx, xy, yy = (moment / np.maximum(count, 1.0) for moment in (x, y, xx, xy, yy))
    half, root = (xx - x * x + yy - y * y) / 2, np.hypot((xx - x * x - yy + y * y) / 2, xy - x * y)
    spread = half - root > _LEAST_SPREAD**2 * (half + root)
    return np.asarray((count >= LEAST_CELLS) & (np.hypot(x, y) <= aside_m) & spread)


def map_hazards(cloud: Cloud, lander: Lander) -> HazardMap:
    """Map what the points of a flight tell of the ground."""
    points_m, sigma_m = cloud.seen_m, np.maximum(cloud.seen_sigma_m, _LEAST_SIGMA_M)
    east_m, north_m = _axes(points_m, lander.footprint_m)
    row, column, within = cells_of(points_m, east_m, north_m, CELL_M)
    kept = np.flatnonzero(within)
    kept = kept[last_of_cells(points_m[kept, :2], CELL_M)]
    cell = row[kept], column[kept]
    height_m = np.full((len(north_m), len(east_m)), np.nan)
    height_m[cell] = points_m[kept, 2]
    ground = predict_heights(points_m, sigma_m, places_of(east_m, north_m)[cell].reshape(-1, 2))
    margin = margin_cells(lander.footprint_m)
    inner = tuple(place + margin for place in cell)
    number = np.full([side + 2 * margin for side in height_m.shape], -1)
    number[inner] = np.arange(len(kept))
    of_cells = (-1, len(PLACES_M))
    known_m, known_sigma_m = np.full((*number.shape, len(PLACES_M)), np.nan), np.full(number.shape, np.nan)
    known_m[inner] = ground.expected_m.reshape(of_cells)
    known_sigma_m[inner] = np.hypot(sigma_m[kept], ground.deviation_m.reshape(of_cells).max(axis=1))
    slope_deg, roughness_m, rough_within, safe = np.full((4, height_m.size), np.nan)
    for planes in fit_planes(known_m, known_sigma_m, lander.footprint_m):
        slope_deg[planes.footprint], roughness_m[planes.footprint] = planes.slope_deg, planes.roughness_m
        rough_within[planes.footprint] = _within(planes, ground, number, lander.step_m).prod(axis=1)
        safe[planes.footprint] = slope_within(planes.gradient, planes.covariance, lander.slope_deg)
    safe *= rough_within * _between(number >= 0, rough_within, lander.footprint_m)
    bands = (values.reshape(height_m.shape) for values in (slope_deg, roughness_m, safe))
    return HazardMap(lander, east_m, north_m, height_m, *bands)


def places_of(east_m: FloatArray, north_m: FloatArray) -> FloatArray:
    """(rows, columns, places, 2) East and north of the places of cells with these centres."""
    return np.asarray(np.stack(np.meshgrid(east_m, north_m), axis=-1)[:, :, None] + PLACES_M)


def _axes(points_m: FloatArray, footprint_m: float) -> list[FloatArray]:
    """Centres of the cells about the points, of a footprint's width at least."""
    middle_m = np.median(points_m[:, :2], axis=0)
    low_m = np.clip(points_m[:, :2].min(axis=0), middle_m - _MOST_HALF_M, middle_m - footprint_m / 2)
    high_m = np.clip(points_m[:, :2].max(axis=0), middle_m + footprint_m / 2, middle_m + _MOST_HALF_M)
    first, last = (np.floor(edge_m / CELL_M).astype(np.int64) for edge_m in (low_m, high_m))
    return [(np.arange(first[k], last[k] + 1) + 0.5) * CELL_M for k in range(2)]


def cells_of(
    points_m: FloatArray, east_m: FloatArray, north_m: FloatArray, cell_m: float
) -> tuple[IntArray, IntArray, BoolArray]:
    """Row and column of each point (n, 2 or 3) among cells with these centres, and whether it is in one of them."""
    column, row = (
        np.floor((points_m[:, k] - axis_m[0]) / cell_m + 0.5).astype(np.int64)
        for k, axis_m in enumerate((east_m, north_m))
    )
    return row, column, (column >= 0) & (column < len(east_m)) & (row >= 0) & (row < len(north_m))


def true_bands(height_m: FloatArray, lander: Lander) -> tuple[FloatArray, FloatArray]:
    """Slope in degrees and roughness in metres of every footprint, (rows, columns), from true heights at places."""
    margin = margin_cells(lander.footprint_m)
    shape = tuple(side - 2 * margin for side in height_m.shape[:2])
    slope_deg, roughness_m = np.full((2, int(np.prod(shape))), np.nan)
    for planes in fit_planes(height_m, np.zeros(height_m.shape[:2]), lander.footprint_m):
        slope_deg[planes.footprint], roughness_m[planes.footprint] = planes.slope_deg, planes.roughness_m
    return slope_deg.reshape(shape), roughness_m.reshape(shape)


def _within(planes: Planes, ground: Heights, number: IntArray, step_m: float) -> FloatArray:
    """(n, cells of a footprint) Probability that the ground is within a step of the plane, 1 in cells without a point.

    Different cells are taken as independent. The places of one cell are not: its least probable one counts twice.
    """
    place = len(PLACES_M) * number.ravel()[planes.cells][..., None] + np.arange(len(PLACES_M))
    mean_m, own_m = ground.mean_m - ground.expected_m, ground.sigma_m
    reach_m = np.where(ground.weight > _LEAST_WEIGHT, np.abs(mean_m) + _SIGMAS * own_m, 0.0).max(axis=0)
    close = np.abs(planes.off_m) + reach_m[place] > step_m  # not where the height is unknown: NaN
    place, off_m = place[close], planes.off_m[close]
    weight, mean_m, own_m = ground.weight[:, place], mean_m[:, place] + off_m, own_m[:, place]
    inside = ndtr((step_m - mean_m) / own_m) - ndtr((-step_m - mean_m) / own_m)
    within = np.ones_like(planes.off_m)
    within[close] = (weight * inside).sum(axis=0)
    return np.asarray(within.min(axis=2) ** _INDEPENDENT)


def _between(seen: BoolArray, within: FloatArray, footprint_m: float) -> FloatArray:
    """Probability that the unseen part of each footprint is within the step, (footprints,).

    Ground deviates together, so cells do not count one by one: a part is within the step as often as the seen parts
    of the map are, to the power of its size over theirs.
    """
    # An obstacle that matters is as wide as a cell and its neighbour: beside a cell that was seen there is none unseen.
    unseen = ~binary_dilation(seen, np.ones((3, 3)))
    cells = footprint_cells(footprint_m)
    share = fftconvolve(unseen, cells / cells.sum(), mode="valid").ravel().clip(0.0, 1.0)
    known = np.isfinite(within)
    # Half a footprint more than seen (Jeffreys): none among n does not say that there is none.
    often = (within[known].sum() + 0.5) / (known.sum() + 1)
    return np.asarray(often ** (share / max(1.0 - share[known].sum() / max(known.sum(), 1), 1e-3)))


def write_map(found: HazardMap, path: Path) -> None:
    """Write the bands as a GeoTIFF in metres of the site frame, rows from the north, or as a `.npz` with its axes.

    Raises:
        InputError: see `check_raster_path`.
        RunError: writing failed.
    """
    check_raster_path(path, MAP_SUFFIXES)
    bands = {
        name: getattr(found, name) for name in ("height_m", "slope_deg", "roughness_m", "safe_probability")
    }
    limits = {f"lander_{name}": limit for name, limit in found.lander._asdict().items()}
    if path.suffix == ".tif":
        upright = {name: values[::-1].astype(np.float32) for name, values in bands.items()}
        content = geotiff(upright, CELL_M, float(found.east_m[0]), float(found.north_m[-1]), limits)
    else:
        memory = io.BytesIO()
        np.savez_compressed(memory, east_m=found.east_m, north_m=found.north_m, **bands, **limits)
        content = memory.getvalue()
    with whole_file(path) as file:
        file.write(content)
