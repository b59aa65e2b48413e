"""The true hazards of a ground, which of them a flight's points detect, and where points raise false alarms.

A hazard is a connected part of the ground that is off the mean of the ring about it, up or down, as points are in
`lidar_emu.report.hazards`: a boulder, a crater or a step, whatever the ground is made of.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation, find_objects, label
from scipy.signal import fftconvolve

from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.binomial import exact_interval
from lidar_emu.report.ground_survey import GroundSurvey
from lidar_emu.report.hazard_map import HazardMap, cells_of, margin_cells, places_of, true_bands
from lidar_emu.report.hazards import CELL_M, INNER_M, OUTER_M, Cloud
from lidar_emu.scene.ray_hits import Scene

_FINE_M = 0.25
"""Spacing of the true heights."""
_LONG = 3.0
"""Ratio of length to width from which a hazard is a step."""
CONFIDENCE = 0.95
_DOUBT = (1 - CONFIDENCE) / 2
_RELIABILITY = np.array([0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98])
"""Limits of the classes of safe probabilities."""


class TrueHazard(NamedTuple):
    """A hazard of the ground, and whether it was detected."""

    east_m: float
    north_m: float
    height_m: float
    """Largest height above the ground around it; below it, if negative."""
    length_m: float
    width_m: float
    """Extent along and across its principal axis."""
    azimuth_rad: float
    """Direction of the length, from east to north."""
    touched: bool
    """Whether a point is on it."""
    detected: bool
    """Whether a point on it is detected as a hazard."""

    @property
    def kind(self) -> str:
        """`step`, `boulder` or `crater`."""
        return (
            "step" if self.length_m > _LONG * self.width_m else "boulder" if self.height_m > 0 else "crater"
        )


class DetectionTally(NamedTuple):
    """Hazard detection of some flights, counted."""

    hazards: list[TrueHazard]
    """From half the lander's step on."""
    level: int
    """Points that are off all hazards."""
    alarms: int
    """Those that are detected as hazards: false alarms."""
    probability: FloatArray
    """(footprints,) Safe probabilities of the maps."""
    safe: BoolArray
    """(footprints,) Whether slope and roughness of the ground, every 0.25 m, are within the lander's limits."""

    @property
    def alarm_interval(self) -> tuple[float, float]:
        """Interval of the probability of a false alarm of a point, of confidence `CONFIDENCE`."""
        return exact_interval(self.alarms, self.level, _DOUBT)


class DetectionRow(NamedTuple):
    """Hazards of one class of heights."""

    low_m: float
    high_m: float
    hazards: int
    touched: int
    detected: int

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of the probability of detection, of confidence `CONFIDENCE`."""
        return exact_interval(self.detected, self.hazards, _DOUBT)


class ReliabilityRow(NamedTuple):
    """Footprints of one class of safe probabilities."""

    stated: float
    """Mean safe probability."""
    landing_areas: int
    safe: float
    """Share of them that is safe."""


def detected_points(cloud: Cloud, step_m: float) -> BoolArray:
    """(points,) Whether a point stands out by more than the noise, and more than the lander stands."""
    return np.asarray(cloud.stands_out & (np.abs(cloud.off_m) > step_m))


def verify(cloud: Cloud, found: HazardMap, scene: Scene) -> tuple[DetectionTally, GroundSurvey, FloatArray]:
    """Compare the hazards that points detect in the area of a map, and the map, with the ground there.

    Returns:
        What is counted, the ground, and its slope in degrees under the footprint about each cell of the map.
    """
    step_m = found.lander.step_m
    rim = int(OUTER_M / _FINE_M)
    east_m, north_m = (_lattice(axis_m, CELL_M, 0, _FINE_M) for axis_m in (found.east_m, found.north_m))
    around_m = [_lattice(axis_m, _FINE_M, rim, _FINE_M) for axis_m in (east_m, north_m)]
    around = np.meshgrid(*around_m)
    up_m = scene.height_m(*(at_m.ravel() for at_m in around)).reshape(around[0].shape)
    off_m = up_m[rim:-rim, rim:-rim] - _ring_mean(up_m)
    row, column, within = cells_of(cloud.seen_m[cloud.own], east_m, north_m, _FINE_M)
    touched, detected = np.zeros((2, *off_m.shape), dtype=np.bool_)
    touched[row[within], column[within]] = True
    positive = within & detected_points(cloud, step_m)
    detected[row[positive], column[positive]] = True
    off_all = ~binary_dilation(np.abs(off_m) > step_m / 2, np.ones((3, 3)))
    level = within.copy()
    level[within] = off_all[row[within], column[within]]
    margin = margin_cells(found.lander.footprint_m)
    lattice_m = [_lattice(axis_m, CELL_M, margin, CELL_M) for axis_m in (found.east_m, found.north_m)]
    places_m = places_of(*lattice_m)
    slope_deg, roughness_m = true_bands(
        scene.height_m(*places_m.reshape(-1, 2).T).reshape(places_m.shape[:3]), found.lander
    )
    known = np.isfinite(found.safe_probability)
    safe = (slope_deg < found.lander.slope_deg) & (roughness_m < step_m)
    masks, axes_m = (touched, detected), (east_m, north_m)
    hazards = [each for sign in (1.0, -1.0) for each in _hazards(sign, off_m, step_m / 2, masks, axes_m)]
    alarms = int((level & positive).sum())
    tally = DetectionTally(hazards, int(level.sum()), alarms, found.safe_probability[known], safe[known])
    ground = GroundSurvey(scene.description, east_m, north_m, up_m[rim:-rim, rim:-rim], None)
    return tally, ground, slope_deg


def total(flights: Sequence[DetectionTally]) -> DetectionTally:
    """Count the hazards, false alarms and footprints of flights together."""
    hazards, level, alarms, probability, safe = zip(*flights, strict=True)
    every = [hazard for flight in hazards for hazard in flight]
    return DetectionTally(every, sum(level), sum(alarms), np.concatenate(probability), np.concatenate(safe))


def by_height(hazards: Sequence[TrueHazard], step_m: float) -> list[DetectionRow]:
    """Count hazards by classes of height, of a factor of 1.41 each, from half a step on."""
    height_m = np.abs([hazard.height_m for hazard in hazards])
    number = np.floor(2 * np.log2(height_m / (step_m / 2)) + 1e-9).astype(np.int64)
    rows = []
    for k in range(int(number.max(initial=-1)) + 1):
        own = [hazard for hazard, n in zip(hazards, number, strict=True) if n == k]
        low_m, high_m = (step_m / 2 * 2 ** (edge / 2) for edge in (k, k + 1))
        touched, detected = sum(hazard.touched for hazard in own), sum(hazard.detected for hazard in own)
        rows.append(DetectionRow(low_m, high_m, len(own), touched, detected))
    return rows


def by_probability(tally: DetectionTally) -> list[ReliabilityRow]:
    """Count footprints by classes of their safe probability."""
    number = np.digitize(tally.probability, _RELIABILITY)
    owns = [number == k for k in np.unique(number)]
    return [
        ReliabilityRow(float(tally.probability[own].mean()), int(own.sum()), float(tally.safe[own].mean()))
        for own in owns
    ]


def _lattice(axis_m: FloatArray, cell_m: float, rim: int, step_m: float) -> FloatArray:
    """Centres of cells over the same axis, with a rim of some on both sides."""
    low_m = axis_m[0] - cell_m / 2
    count = round((axis_m[-1] + cell_m / 2 - low_m) / step_m)
    return np.asarray(low_m + step_m * (np.arange(-rim, count + rim) + 0.5))


def _ring_mean(up_m: FloatArray) -> FloatArray:
    """Mean of the heights in the ring about each place, where the ring is complete."""
    side = np.arange(-int(OUTER_M / _FINE_M), int(OUTER_M / _FINE_M) + 1) * _FINE_M
    away_m = np.hypot(side[:, None], side)
    ring = ((away_m >= INNER_M) & (away_m <= OUTER_M)).astype(float)
    known = np.isfinite(up_m)
    middle_m = float(np.median(up_m[known])) if known.any() else 0.0
    total = fftconvolve(np.where(known, up_m - middle_m, 0.0), ring, mode="valid")
    count = fftconvolve(known.astype(float), ring, mode="valid").round()
    return np.asarray(middle_m + total / np.where(count > 0, count, np.nan))


def _hazards(
    sign: float,
    off_m: FloatArray,
    least_m: float,
    masks: tuple[BoolArray, BoolArray],
    axes_m: tuple[FloatArray, FloatArray],
) -> Iterator[TrueHazard]:
    """Hazards above the ground, or below it with sign -1; masks: places with a point, with a detected one."""
    labels, _ = label(sign * off_m > least_m, np.ones((3, 3)))
    for number, box in enumerate(find_objects(labels), start=1):
        own = labels[box] == number
        row, column = np.nonzero(own)
        place_m = np.stack([axes_m[0][box[1]][column], axes_m[1][box[0]][row]])
        # Extents, not moments: those of a crater's rim are too large.
        _, axes = np.linalg.eigh(np.cov(place_m, ddof=0))
        low_m, high_m = (reach(axes.T @ place_m, axis=1) for reach in (np.min, np.max))
        east_m, north_m = axes @ (low_m + high_m) / 2
        width_m, length_m = (high_m - low_m + _FINE_M).tolist()
        yield TrueHazard(
            float(east_m),
            float(north_m),
            sign * float((sign * off_m[box][own]).max()),
            length_m,
            width_m,
            float(np.arctan2(axes[1, 1], axes[0, 1])),
            *(bool(mask[box][own].any()) for mask in masks),
        )
