"""Detection of boulders, craters and steps in the points of a flight, and heights of the ground between these points.

A point is detected as a hazard if its distance from the plane through the surrounding points exceeds the measurement
noise, for a boulder, a step or a crater rim alike. No method detects hazards between the points.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from lidar_emu.errors import Finding, InputError
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import BLOCK_SHOTS, initial_state, measure

INNER_M, OUTER_M = 2.5, 5.0
"""Radii of the ring of points for the plane: an obstacle as wide as the hole keeps its full height above the plane."""
LEAST_POINTS = 4
"""Least number of points in a ring."""
CELL_M = 0.5
"""Side of a cell. Rings and maps use only the last point in each, so that points piled up by hovering count once: noise
of the same rounding does not average out."""
_POINTS_AT_ONCE = 2048
SIGMAS = 4.0
"""Detection threshold in standard deviations; with Gaussian errors one point in 16 000 is a false alarm."""
_LEAST_SPREAD = 0.05
"""Least ratio of the spread of a ring's points across and along their line that determines a slope across."""


_NEIGHBOURS = 12
"""Points that predict the height of a place."""
_HURST = 0.5
"""Exponent of ground with sharp edges and tips; that of smooth ground is higher, and predicts tips too low."""
_SPREADS_M = np.geomspace(0.005, 2.5, 6)
"""Roughness of smooth to rocky ground: rms difference of heights 1 m apart, over the root of two."""
_STEPS = 30


class Cloud(NamedTuple):
    """Points with a ring of others around them, (points,), among all points of a flight."""

    seen_m: FloatArray
    """(all, 3) All measured points, east, north, up, including points without a ring."""
    seen_sigma_m: FloatArray
    """(all,) Standard deviation of up, from the instrument's stated sigma."""
    seen_beam: IntArray
    """(all,) Beams of these points."""
    own: IntArray
    """(points,) Where among them the points with a ring are."""
    off_m: FloatArray
    """Measured height above the plane through the ring."""
    sigma_m: FloatArray
    """Standard deviation of `off_m` from the instrument's stated sigma."""

    @property
    def stands_out(self) -> BoolArray:
        """(points,) Whether the point is detected as a hazard."""
        return np.asarray(np.abs(self.off_m) > SIGMAS * self.sigma_m)


def cloud_of(model: FlightModel) -> Cloud:
    """Fly a scenario, and compare every measured point with its neighbours.

    Raises:
        InputError: no measured point has enough neighbours.
    """
    measurement, true_m = _measure(model)
    valid = measurement.range_valid & np.isfinite(true_m[..., 2])
    points_m, truth_m = measurement.point_site_m[valid], true_m[valid]
    above_m = np.broadcast_to(measurement.position_site_m[:, None], true_m.shape)[valid] - truth_m
    sigma_m = measurement.sigma_range_m[valid] * above_m[:, 2] / np.linalg.norm(above_m, axis=-1)
    rings = _rings(points_m[:, :2])
    if not rings:
        remedy = f"must be a flight whose measured points are less than {OUTER_M:g} m apart"
        raise InputError(model.scenario.name, None, Finding("a flight without neighbouring points"), remedy)
    own = np.array([ring.point for ring in rings])
    planes_m = np.array([_plane(points_m[:, 2], sigma_m, ring) for ring in rings])
    return Cloud(
        seen_m=points_m,
        seen_sigma_m=sigma_m,
        seen_beam=np.nonzero(valid)[1],
        own=own,
        off_m=points_m[own, 2] - planes_m[:, 0],
        sigma_m=np.hypot(sigma_m[own], planes_m[:, 1]),
    )


def _measure(model: FlightModel) -> tuple[Measurement, FloatArray]:
    """Measure the flight; also return the ends of the true ranges along the published axes, (shots, beams, 3)."""
    state, blocks, true_m = initial_state(model), [], []
    for first in range(0, model.shot_count, BLOCK_SHOTS):
        before = state.scanner
        block, state, _ = measure(model, first, min(BLOCK_SHOTS, model.shot_count - first), state)
        blocks.append(block)
        true_m.append(model.points_site_m(replace(block, range_m=block.true_range_m), before))
    return Measurement.concatenate(blocks), np.concatenate(true_m)


class _Ring(NamedTuple):
    point: int
    others: IntArray
    offset_m: FloatArray
    """(others, 2) East and north offset from the point."""


def _rings(east_north_m: FloatArray) -> list[_Ring]:
    kept = last_of_cells(east_north_m, CELL_M)
    tree, rings = cKDTree(east_north_m[kept]), []
    for first in range(0, len(east_north_m), _POINTS_AT_ONCE):
        around = tree.query_ball_point(
            east_north_m[first : first + _POINTS_AT_ONCE], OUTER_M, return_sorted=True
        )
        for point, near in enumerate(around, start=first):
            others = kept[near]
            offset_m = east_north_m[others] - east_north_m[point]
            outside = np.hypot(offset_m[:, 0], offset_m[:, 1]) >= INNER_M
            if np.count_nonzero(outside) >= LEAST_POINTS:
                rings.append(_Ring(point, others[outside], offset_m[outside]))
    return rings


def last_of_cells(east_north_m: FloatArray, cell_m: float) -> IntArray:
    """Indices of the last point in each cell of a grid."""
    cells = np.floor(east_north_m[::-1] / cell_m).astype(np.int64)
    _, from_last = np.unique(cells, axis=0, return_index=True)
    return np.asarray(len(cells) - 1 - from_last)


def _plane(up_m: FloatArray, sigma_m: FloatArray, ring: _Ring) -> FloatArray:
    """Evaluate the plane through a ring at its centre: measured height, and its sigma.

    Points on a line do not determine the slope across it, which is then taken as zero.
    """
    design = np.column_stack([np.ones(len(ring.others)), ring.offset_m / OUTER_M])
    weight = np.linalg.pinv(design, rcond=_LEAST_SPREAD)[0]
    others = ring.others
    return np.array([(weight * up_m[others]).sum(), np.sqrt(((weight * sigma_m[others]) ** 2).sum())])


class Heights(NamedTuple):
    """Distribution of the ground's height at places: a mixture of Gaussians, each (parts, places)."""

    weight: FloatArray
    mean_m: FloatArray
    sigma_m: FloatArray

    @property
    def expected_m(self) -> FloatArray:
        """(places,)"""
        return np.asarray((self.weight * self.mean_m).sum(axis=0))

    @property
    def deviation_m(self) -> FloatArray:
        """(places,) Standard deviation."""
        return np.asarray(
            np.sqrt((self.weight * (self.sigma_m**2 + (self.mean_m - self.expected_m) ** 2)).sum(axis=0))
        )


def predict_heights(points_m: FloatArray, sigma_m: FloatArray, places_m: FloatArray) -> Heights:
    """Predict heights at places, (n, 2), from the points about each, by kriging with a linear drift.

    The ground's roughness differs from place to place: each part of the mixture is one roughness, with a weight by
    Bayes' rule from the points about the place, and from how frequent it is everywhere (expectation maximisation).
    """
    kept = last_of_cells(points_m[:, :2], CELL_M / 2)
    points_m, variance = points_m[kept], sigma_m[kept] ** 2
    _, near = cKDTree(points_m[:, :2]).query(places_m, k=min(_NEIGHBOURS, len(kept)))
    blocks = [slice(first, first + _POINTS_AT_ONCE) for first in range(0, len(places_m), _POINTS_AT_ONCE)]
    parts = [_krige(points_m[near[k]], variance[near[k]].mean(axis=1), places_m[k]) for k in blocks]
    likelihood, mean_m, own_m = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
    share = np.full((len(_SPREADS_M), 1), 1.0 / len(_SPREADS_M))
    for _ in range(_STEPS):
        weight = share * likelihood
        weight /= weight.sum(axis=0)
        share = weight.mean(axis=1, keepdims=True)
    return Heights(weight, mean_m, own_m)


def _krige(
    near_m: FloatArray, variance: FloatArray, places_m: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Likelihood, mean and standard deviation at each place, for each roughness, from its neighbours, (n, k, 3).

    Combinations of the heights that no plane changes, along the axes of their covariance, are independent for every
    roughness at once (universal kriging, Matheron 1969).
    """
    offset_m = near_m[..., :2] - places_m[:, None]
    drift = np.concatenate([np.ones((*offset_m.shape[:2], 1)), offset_m], axis=-1)
    free = np.linalg.qr(drift, mode="complete")[0][..., 3:]
    # Points on a line do not determine the slope across it, which is then taken as zero.
    plane = np.linalg.pinv(drift, rcond=_LEAST_SPREAD)[:, 0]
    between = -(np.linalg.norm(offset_m[:, :, None] - offset_m[:, None], axis=-1) ** (2 * _HURST))
    away = -(np.linalg.norm(offset_m, axis=-1) ** (2 * _HURST))
    bent = np.einsum("nkl,nl->nk", between, plane)
    own, axes = np.linalg.eigh(np.swapaxes(free, 1, 2) @ between @ free)
    axes = free @ axes
    seen_m = np.einsum("nkj,nk->nj", axes, near_m[..., 2])
    shared = np.einsum("nkj,nk->nj", axes, away - bent)
    on_plane_m = (plane * near_m[..., 2]).sum(axis=1)
    off_plane, noise = (plane * (bent - 2 * away)).sum(axis=1), variance * (plane**2).sum(axis=1)
    log, mean_m, square = [], [], []
    for rough in _SPREADS_M**2:
        both = rough * np.maximum(own, 0.0) + variance[:, None]
        log.append(-0.5 * (seen_m**2 / both + np.log(both)).sum(axis=1))
        mean_m.append(on_plane_m + (rough * shared / both * seen_m).sum(axis=1))
        square.append(rough * off_plane + noise - ((rough * shared) ** 2 / both).sum(axis=1))
    likelihood = np.exp(np.array(log) - np.max(log, axis=0))
    return likelihood, np.array(mean_m), np.sqrt(np.maximum(square, 1e-8))
