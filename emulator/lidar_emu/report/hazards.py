"""Which boulders, steps and slopes a flight's points tell, held against the points that a perfect instrument gives.

A point stands out if it lies off the plane through the points around it by more than chance explains. The same plane
through the true points says by how much it really does: a boulder, a step, the rim of a crater alike. What is between
the points no method finds: how many boulders of a size have a point on them is counted from the points' places.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from lidar_emu.errors import Finding, InputError
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import BLOCK_SHOTS, initial_state, measure

INNER_M, OUTER_M = 2.5, 5.0
"""The plane goes through the points of this ring around a point: what is as wide as the hole stands out whole."""
LEAST_POINTS = 4
"""Of a ring; fewer are no surroundings."""
_CELL_M = 0.5
"""Of each cell of this size the last point is taken for rings: what hovering piles up in one place counts once."""
_POINTS_AT_ONCE = 2048
SIGMAS = 4.0
"""A point that is farther off stands out: chance alone makes one in 16 000 do so, were errors Gaussian."""
_NINE_OF_TEN = 1.2816
"""Standard deviations below a height at which nine in ten of that height are above the limit."""
_LEAST_SPREAD = 0.05
"""Of the points of a ring across their line, over that along it: less tells no slope."""
BOULDERS_M = (0.5, 1.0, 2.0, 4.0)
CIRCLES_M = (5.0, 10.0, 25.0, 50.0, 100.0)
_PLACES = 4000


class Cloud(NamedTuple):
    """Points of a flight that have surroundings, (points,), and the planes through the beams of its shots, (shots,)."""

    altitude_m: FloatArray
    """Of the vehicle above the point."""
    seen_m: FloatArray
    """(all, 2) East and north of all measured points, those without surroundings too."""
    off_m: FloatArray
    """Height above the plane through the surroundings, as measured."""
    true_off_m: FloatArray
    sigma_m: FloatArray
    """Standard deviation of the error of `off_m`, by the instrument's own account."""
    spacing_m: FloatArray
    """On the ground, from the same beam's point in the shot before."""
    slope_altitude_m: FloatArray
    slope_deg: FloatArray
    true_slope_deg: FloatArray
    """Of the plane through the true points of the same beams."""
    slope_sigma_deg: FloatArray
    slope_base_m: FloatArray
    """Diameter of the circle through the beams' points, about."""

    @property
    def stands_out(self) -> BoolArray:
        """(points,)"""
        return np.asarray(np.abs(self.off_m) > SIGMAS * self.sigma_m)


@dataclass(frozen=True)
class Band:
    """Detection statistics of the points in one band of altitudes; None where the band has no such points."""

    low_m: float
    high_m: float
    points: int
    spacing_m: float
    """Median distance on the ground from a beam's point to its next."""
    detected_from_m: float
    """Median height at which nine in ten points are detected, by the instrument's own sigma."""
    higher: int
    """Points whose true height above or below their surroundings is at least `detected_from_m`."""
    detected: float | None
    """Fraction of the higher points that are detected."""
    level: int
    """Points whose true height is less than a quarter of `detected_from_m`."""
    alarms: float | None
    """Fraction of the level points that are detected: false alarms."""
    slope_base_m: float
    slope_error_deg: float
    """Root mean square, against the plane through the true points."""
    slope_sigma_deg: float
    """Root mean square predicted by the instrument's own sigma."""


def cloud_of(model: FlightModel) -> Cloud:
    """Fly, and judge every measured point by its neighbours.

    Raises:
        InputError: nothing was measured that has surroundings.
    """
    measurement, true_m = _measure(model)
    valid = measurement.range_valid & np.isfinite(true_m[..., 2])
    points_m, truth_m = measurement.point_site_m[valid], true_m[valid]
    above_m = np.broadcast_to(measurement.position_site_m[:, None], true_m.shape)[valid] - truth_m
    sigma_m = measurement.sigma_range_m[valid] * above_m[:, 2] / np.linalg.norm(above_m, axis=-1)
    rings = _rings(points_m[:, :2])
    if not rings:
        allowed = f"allowed: one that measures points less than {OUTER_M:g} m apart"
        raise InputError(
            model.scenario.name, None, Finding("a flight of which no point has surroundings"), allowed
        )
    own = np.array([ring.point for ring in rings])
    planes_m = np.array([_plane(points_m, truth_m, sigma_m, ring) for ring in rings])
    return Cloud(
        altitude_m=above_m[own, 2],
        seen_m=points_m[:, :2],
        off_m=points_m[own, 2] - planes_m[:, 0],
        true_off_m=truth_m[own, 2] - planes_m[:, 1],
        sigma_m=np.hypot(sigma_m[own], planes_m[:, 2]),
        spacing_m=_spacing(true_m)[valid][own],
        **_slopes(measurement, true_m),
    )


def bands_of(cloud: Cloud) -> list[Band]:
    """Octaves of altitude, from the highest downward."""
    octave = np.floor(np.log2(np.maximum(cloud.altitude_m, 1.0))).astype(np.int64)
    slope_octave = np.floor(np.log2(np.maximum(cloud.slope_altitude_m, 1.0))).astype(np.int64)
    bands = (_band(cloud, int(k), octave == k, slope_octave == k) for k in np.unique(octave)[::-1])
    return list(bands)


def touched_shares(cloud: Cloud, centre_m: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    """(circles, boulders) Share of the places within a circle at which a boulder would have a point on it.

    Args:
        cloud: of a flight.
        centre_m: east and north of the circles of `CIRCLES_M`, radii; boulders are of the diameters `BOULDERS_M`.
    """
    # A sunflower's seeds: even over a disc without chance.
    number = np.arange(_PLACES) + 0.5
    radius, turn = np.sqrt(number / _PLACES), np.pi * (1 + np.sqrt(5)) * number
    places = np.stack([radius * np.sin(turn), radius * np.cos(turn)], axis=-1)
    tree = cKDTree(cloud.seen_m)
    away_m = np.stack([tree.query(np.array(centre_m) + circle_m * places)[0] for circle_m in CIRCLES_M])
    return np.asarray((away_m[..., None] < np.array(BOULDERS_M) / 2).mean(axis=1))


def _measure(model: FlightModel) -> tuple[Measurement, FloatArray]:
    """The flight, and where its beams' true ranges end along the published axes, (shots, beams, 3)."""
    state, blocks, true_m = initial_state(model), [], []
    for first in range(0, model.shot_count, BLOCK_SHOTS):
        before = state.scanner
        block, state, _ = measure(model, first, min(BLOCK_SHOTS, model.shot_count - first), state)
        blocks.append(block)
        true_m.append(model.points_site_m(replace(block, range_m=block.true_range_m), before))
    return Measurement.concatenate(blocks), np.concatenate(true_m)


def _spacing(true_m: FloatArray) -> FloatArray:
    """(shots, beams)"""
    steps_m = np.linalg.norm(np.diff(true_m[..., :2], axis=0), axis=-1)
    return np.concatenate([steps_m[:1], steps_m])


class _Ring(NamedTuple):
    """The points around a point."""

    point: int
    others: IntArray
    offset_m: FloatArray
    """(others, 2) East and north of the point."""


def _rings(east_north_m: FloatArray) -> list[_Ring]:
    """The surroundings of those points that have some."""
    kept = _last_of_cells(east_north_m)
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


def _last_of_cells(east_north_m: FloatArray) -> IntArray:
    """Indices of the points that rings consist of."""
    cells = np.floor(east_north_m[::-1] / _CELL_M).astype(np.int64)
    _, from_last = np.unique(cells, axis=0, return_index=True)
    return np.asarray(len(cells) - 1 - from_last)


def _plane(points_m: FloatArray, truth_m: FloatArray, sigma_m: FloatArray, ring: _Ring) -> FloatArray:
    """Height at the point of the plane through its ring, as measured, in truth, and the former's standard deviation.

    Points on a line tell no slope across it: none is taken there.
    """
    design = np.column_stack([np.ones(len(ring.others)), ring.offset_m / OUTER_M])
    weight = np.linalg.pinv(design, rcond=_LEAST_SPREAD)[0]
    heights_m = points_m[ring.others, 2], truth_m[ring.others, 2]
    measured_m, true_m = (float((weight * height_m).sum()) for height_m in heights_m)
    return np.array([measured_m, true_m, np.sqrt(((weight * sigma_m[ring.others]) ** 2).sum())])


def _slopes(measurement: Measurement, true_m: FloatArray) -> dict[str, FloatArray]:
    """The plane through all beams of each shot in which three or more have been measured."""
    seen = measurement.range_valid & np.isfinite(true_m[..., 2])
    if measurement.beam_count < 3:
        seen = np.zeros_like(seen)
    shots = np.flatnonzero(seen.sum(axis=1) >= 3)
    points_m, truth_m = measurement.point_site_m[shots], true_m[shots]
    weight = seen[shots].astype(float)
    centre_m = _mean(truth_m, weight)
    altitude_m = measurement.position_site_m[shots, 2] - centre_m[:, 2]
    offset_m = np.where(weight[..., None] > 0, truth_m - centre_m[:, None], 0.0)
    design = np.concatenate([weight[..., None], offset_m[..., :2]], axis=-1)
    inverse = np.linalg.pinv(design)[:, 1:]
    range_m = np.where(weight > 0, measurement.true_range_m[shots], 1.0)
    sigma_m = np.where(weight > 0, measurement.sigma_range_m[shots], 0.0) * altitude_m[:, None] / range_m
    up_m = [
        np.where(weight > 0, heights[..., 2] - centre_m[:, None, 2], 0.0) for heights in (points_m, truth_m)
    ]
    slope, true_slope = ((inverse * height_m[:, None]).sum(axis=-1) for height_m in up_m)
    variance = ((inverse * sigma_m[:, None]) ** 2).sum(axis=-1).mean(axis=-1)
    away_m = np.sqrt((offset_m[..., :2] ** 2).sum(axis=(-2, -1)) / weight.sum(axis=-1))
    return {
        "slope_altitude_m": altitude_m,
        "slope_deg": np.degrees(np.arctan(np.linalg.norm(slope, axis=-1))),
        "true_slope_deg": np.degrees(np.arctan(np.linalg.norm(true_slope, axis=-1))),
        "slope_sigma_deg": np.degrees(np.sqrt(variance)),
        "slope_base_m": 2 * away_m,
    }


def _mean(points_m: FloatArray, weight: FloatArray) -> FloatArray:
    known_m = np.where(weight[..., None] > 0, points_m, 0.0)
    return np.asarray(known_m.sum(axis=1) / weight.sum(axis=1)[:, None])


def _band(cloud: Cloud, octave: int, own: BoolArray, own_slope: BoolArray) -> Band:
    sigma_m = cloud.sigma_m[own]
    detected_from_m = (SIGMAS + _NINE_OF_TEN) * sigma_m
    off_m, out = np.abs(cloud.true_off_m[own]), cloud.stands_out[own]
    higher, level = off_m >= detected_from_m, off_m < detected_from_m / 4
    error_deg = (cloud.slope_deg - cloud.true_slope_deg)[own_slope]
    some = error_deg.size > 0
    return Band(
        low_m=2.0**octave,
        high_m=2.0 ** (octave + 1),
        points=int(own.sum()),
        spacing_m=float(np.nanmedian(cloud.spacing_m[own])),
        detected_from_m=float(np.median(detected_from_m)),
        higher=int(higher.sum()),
        detected=float(out[higher].mean()) if higher.any() else None,
        level=int(level.sum()),
        alarms=float(out[level].mean()) if level.any() else None,
        slope_base_m=float(np.median(cloud.slope_base_m[own_slope])) if some else np.nan,
        slope_error_deg=float(np.sqrt(np.mean(error_deg**2))) if some else np.nan,
        slope_sigma_deg=float(np.sqrt(np.mean(cloud.slope_sigma_deg[own_slope] ** 2))) if some else np.nan,
    )
