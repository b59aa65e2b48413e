"""A hazard map from the points of a flight: height, slope, roughness, and the probability that a lander stands safely.

As in ALHAT's hazard detection, slope and roughness are those of the plane through the heights under a lander's
footprint, and the noise of the heights makes them random (Ivanov, Huertas and Carson, AIAA 2013-5019). Between the
points heights are as likely to be obstacles as they are at the points (after Tomita and Ho, AAS 23-391).
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

from lidar_emu.files import check_destination, check_extra, check_suffix, whole_file
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.report.ground_survey import geotiff
from lidar_emu.report.hazards import CELL_M, Cloud, last_of_cells

_MOST_HALF_M = 60.0
"""Half of the longest side of a map, about the median of the points."""
LEAST_CELLS = 8
"""Least number of cells with a point under a footprint."""
_LEAST_SPREAD = 0.2
"""Least ratio of their spread across and along the line through them: points on a line determine no slope."""
_MOST_ASIDE = 0.25
"""Largest distance of their centre from the footprint's, in radii: planes are not extrapolated."""
_LEAST_SIGMA_M = 1e-3
_FOOTPRINTS_AT_ONCE = 1024
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
_SIGMAS = 8.0
"""Reach of an integral over a Gaussian."""
_STEPS = 100


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


class Deviations(NamedTuple):
    """Distribution of the ground's heights off the planes: level ground with some obstacles, both Gaussian."""

    obstacle_share: float
    """Share of the cells that are obstacles."""
    level_m: float
    """Standard deviation of level ground."""
    obstacle_m: float
    """Standard deviation of obstacles."""

    def parts(
        self, off_m: FloatArray, sigma_m: FloatArray
    ) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
        """Weight, mean and standard deviation of the true height in both parts, by Bayes' rule from a measured one."""
        parts = (1.0 - self.obstacle_share, self.level_m), (self.obstacle_share, self.obstacle_m)
        variance = [spread_m**2 + sigma_m**2 for _, spread_m in parts]
        likelihood = [
            share * np.exp(-(off_m**2) / (2 * both)) / np.sqrt(both)
            for (share, _), both in zip(parts, variance, strict=True)
        ]
        whole = np.maximum(likelihood[0] + likelihood[1], np.finfo(float).tiny)
        for (_, spread_m), both, like in zip(parts, variance, likelihood, strict=True):
            yield like / whole, off_m * spread_m**2 / both, spread_m * sigma_m / np.sqrt(both)

    def safe(self, off_m: FloatArray, sigma_m: FloatArray, step_m: float) -> FloatArray:
        """Probability that the true height is within a step of the plane."""
        return np.asarray(
            sum(
                weight * (ndtr((step_m - mean_m) / own_m) - ndtr((-step_m - mean_m) / own_m))
                for weight, mean_m, own_m in self.parts(off_m, sigma_m)
            )
        )


def learn_deviations(off_m: FloatArray, sigma_m: FloatArray, step_m: float) -> Deviations:
    """Estimate the distribution of true heights off the planes from measured ones, by expectation maximisation.

    Args:
        off_m: (n,) measured heights.
        sigma_m: (n,) their standard deviations.
        step_m: height from which an obstacle is one.
    """
    found = Deviations(0.01, max(float(np.median(np.abs(off_m))), _LEAST_SIGMA_M), 2 * step_m)
    for _ in range(_STEPS):
        level, obstacle = (
            (weight.sum(), float((weight * (mean_m**2 + own_m**2)).sum()))
            for weight, mean_m, own_m in found.parts(off_m, sigma_m)
        )
        # Half an obstacle more than seen (Jeffreys): none among n cells does not say that there is none.
        found = Deviations(
            float((obstacle[0] + 0.5) / (len(off_m) + 1)),
            max(float(np.sqrt(level[1] / max(level[0], 1e-9))), _LEAST_SIGMA_M),
            max(float(np.sqrt(obstacle[1] / max(obstacle[0], 1e-9))), step_m / 2),
        )
    return found


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
    """Planes through the heights under footprints, (n,), and the heights off them, (n, cells of a footprint)."""

    footprint: IntArray
    """Footprints whose heights determine a plane, as flat indices of the map."""
    gradient: FloatArray
    """(n, 2) To the east and to the north."""
    covariance: FloatArray
    """(n, 2, 2)"""
    off_m: FloatArray
    """NaN in cells without a height."""
    sigma_m: FloatArray

    @property
    def slope_deg(self) -> FloatArray:
        return np.asarray(np.degrees(np.arctan(np.linalg.norm(self.gradient, axis=-1))))

    @property
    def roughness_m(self) -> FloatArray:
        return np.asarray(np.nanmax(np.abs(self.off_m), axis=-1, initial=0.0))


def fit_planes(
    height_m: FloatArray, sigma_m: FloatArray, footprint_m: float, level_m: float
) -> Iterator[Planes]:
    """Fit planes by weighted least squares to the heights under the footprint about each cell.

    Args:
        height_m: (rows + 2 m, columns + 2 m) heights of the map and of a margin of `margin_cells`; NaN: unknown.
        sigma_m: their standard deviations.
        footprint_m: diameter of the footprint.
        level_m: standard deviation of the ground itself off the plane.

    Yields:
        The planes of some footprints at a time.
    """
    margin, (rows, columns) = margin_cells(footprint_m), height_m.shape
    inside = footprint_cells(footprint_m)
    east, north = np.meshgrid(*(np.arange(-margin, margin + 1),) * 2)
    design = np.column_stack([np.ones(inside.sum()), CELL_M * east[inside], CELL_M * north[inside]])
    squares = np.einsum("ki,kj->kij", design, design).reshape(len(design), 9)
    offset = (north * columns + east)[inside]
    row, column = np.arange(margin, rows - margin), np.arange(margin, columns - margin)
    centre = (row[:, None] * columns + column).ravel()
    for first in range(0, len(centre), _FOOTPRINTS_AT_ONCE):
        cells = centre[first : first + _FOOTPRINTS_AT_ONCE, None] + offset
        up_m, own_m = height_m.ravel()[cells], sigma_m.ravel()[cells]
        seen = np.isfinite(up_m)
        index = np.flatnonzero(_determined(seen, squares, _MOST_ASIDE * footprint_m / 2))
        if not index.size:
            continue
        up_m, own_m, seen = up_m[index], own_m[index], seen[index]
        middle_m = np.nanmean(up_m, axis=1, keepdims=True)
        weight = np.where(seen, 1.0 / (own_m**2 + level_m**2), 0.0)
        covariance = np.linalg.inv((weight @ squares).reshape(-1, 3, 3))
        moment = (weight * np.where(seen, up_m - middle_m, 0.0)) @ design
        plane = np.einsum("nij,nj->ni", covariance, moment)
        off_m = up_m - middle_m - plane @ design.T
        yield Planes(first + index, plane[:, 1:], covariance[:, 1:, 1:], off_m, own_m)


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
    points_m, sigma_m = cloud.seen_m, cloud.seen_sigma_m
    once = last_of_cells(points_m[cloud.own, :2], CELL_M)
    deviations = learn_deviations(cloud.off_m[once], cloud.sigma_m[once], lander.step_m)
    east_m, north_m = _axes(points_m, lander.footprint_m)
    row, column, within = cells_of(points_m, east_m, north_m, CELL_M)
    kept = np.flatnonzero(within)
    kept = kept[last_of_cells(points_m[kept, :2], CELL_M)]
    height_m, own_m = np.full((2, len(north_m), len(east_m)), np.nan)
    height_m[row[kept], column[kept]] = points_m[kept, 2]
    own_m[row[kept], column[kept]] = np.maximum(sigma_m[kept], _LEAST_SIGMA_M)
    slope_deg, roughness_m, safe = np.full((3, height_m.size), np.nan)
    margin = margin_cells(lander.footprint_m)
    known_m, known_sigma_m = (np.pad(each, margin, constant_values=np.nan) for each in (height_m, own_m))
    between = _between(np.isfinite(known_m), lander, deviations).ravel()
    for planes in fit_planes(known_m, known_sigma_m, lander.footprint_m, deviations.level_m):
        slope_deg[planes.footprint], roughness_m[planes.footprint] = planes.slope_deg, planes.roughness_m
        safe[planes.footprint] = between[planes.footprint] * safe_where_seen(planes, deviations, lander)
    shape = height_m.shape
    bands = (values.reshape(shape) for values in (slope_deg, roughness_m, safe))
    return HazardMap(lander, east_m, north_m, height_m, *bands)


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
    """Slope in degrees and roughness in metres of every footprint, (rows, columns), from true heights with a margin."""
    margin = margin_cells(lander.footprint_m)
    shape = tuple(side - 2 * margin for side in height_m.shape)
    slope_deg, roughness_m = np.full((2, int(np.prod(shape))), np.nan)
    for planes in fit_planes(height_m, np.ones_like(height_m), lander.footprint_m, 0.0):
        slope_deg[planes.footprint], roughness_m[planes.footprint] = planes.slope_deg, planes.roughness_m
    return slope_deg.reshape(shape), roughness_m.reshape(shape)


def safe_where_seen(planes: Planes, deviations: Deviations, lander: Lander) -> FloatArray:
    """(n,) Probability that slope and heights are within the limits in the cells with a point.

    Deviations of cells are taken as independent: where neighbours deviate together, more footprints are safe than
    this says.
    """
    within = np.ones_like(planes.off_m)
    seen = np.isfinite(planes.off_m)
    within[seen] = deviations.safe(planes.off_m[seen], planes.sigma_m[seen], lander.step_m)
    flat = slope_within(planes.gradient, planes.covariance, lander.slope_deg)
    return np.asarray(within.prod(axis=1) * flat)


def _between(seen: BoolArray, lander: Lander, deviations: Deviations) -> FloatArray:
    """Probability that no obstacle lies between the points under each footprint, (rows, columns)."""
    # An obstacle that matters is as wide as a cell and its neighbour: beside a cell that was seen there is none unseen.
    unseen = ~binary_dilation(seen, np.ones((3, 3)))
    count = fftconvolve(unseen, footprint_cells(lander.footprint_m), mode="valid").round()
    no_noise = deviations.safe(np.zeros(1), np.full(1, 1e6), lander.step_m)
    return np.asarray(no_noise**count)


def check_map_path(path: Path) -> None:
    """Check the path of a map before a flight.

    Raises:
        InputError: the suffix is unknown, the folder is missing or read-only, or `.tif` lacks the extra `geo`.
    """
    check_suffix(path, (".tif", ".npz"))
    if path.suffix == ".tif":
        check_extra(str(path), path.suffix, "rasterio", "geo")
    check_destination(path)


def write_map(found: HazardMap, path: Path) -> None:
    """Write the bands as a GeoTIFF in metres of the site frame, rows from the north, or as a `.npz` with its axes.

    Raises:
        InputError: see `check_map_path`.
        RunError: writing failed.
    """
    check_map_path(path)
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
