"""Detection of boulders, steps and slopes in the points of a flight, compared with the points of a perfect instrument.

A point is detected as a hazard if its distance from the plane through the surrounding points exceeds the measurement
noise. The plane through the true points gives its true distance, for a boulder, a step or a crater rim alike. No method
detects hazards between the points, so the share of boulders with a point on them is counted separately.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from lidar_emu.errors import Finding, InputError
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.report.plot_style import check_plot_path, titled_figure, write_plot
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import BLOCK_SHOTS, initial_state, measure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


INNER_M, OUTER_M = 2.5, 5.0
"""Radii of the ring of points for the plane: an obstacle as wide as the hole keeps its full height above the plane."""
LEAST_POINTS = 4
"""Least number of points in a ring."""
_CELL_M = 0.5
"""Rings use only the last point in each cell of this size, so that points piled up by hovering count once."""
_POINTS_AT_ONCE = 2048
SIGMAS = 4.0
"""Detection threshold in standard deviations; with Gaussian errors one point in 16 000 is a false alarm."""
_NINE_OF_TEN = 1.2816
"""Standard deviations above the threshold at which nine in ten are detected."""
_LEAST_SPREAD = 0.05
"""Least ratio of the spread of a ring's points across and along their line that determines a slope across."""
BOULDERS_M = (0.5, 1.0, 2.0, 4.0)
CIRCLES_M = (5.0, 10.0, 25.0, 50.0, 100.0)
_PLACES = 4000


class Cloud(NamedTuple):
    """Points with a ring of others around them, (points,), and planes through the beams of each shot, (shots,)."""

    altitude_m: FloatArray
    """Height of the vehicle above the point."""
    seen_m: FloatArray
    """(all, 2) East and north of all measured points, including points without a ring."""
    off_m: FloatArray
    """Measured height above the plane through the ring."""
    true_off_m: FloatArray
    """True height above the plane through the true points of the ring."""
    sigma_m: FloatArray
    """Standard deviation of `off_m` from the instrument's stated sigma."""
    spacing_m: FloatArray
    """Distance on the ground to the point of the same beam in the previous shot."""
    slope_altitude_m: FloatArray
    slope_deg: FloatArray
    true_slope_deg: FloatArray
    """Slope of the plane through the true points of the same beams."""
    slope_sigma_deg: FloatArray
    slope_base_m: FloatArray
    """Approximate diameter of the circle through the beams' points."""

    @property
    def stands_out(self) -> BoolArray:
        """(points,) Whether the point is detected as a hazard."""
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

    @property
    def middle_m(self) -> float:
        """Geometric mean of both ends."""
        return float(np.sqrt(self.low_m * self.high_m))


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
    steps_m = np.linalg.norm(np.diff(true_m[..., :2], axis=0), axis=-1)
    planes_m = np.array([_plane(points_m, truth_m, sigma_m, ring) for ring in rings])
    return Cloud(
        altitude_m=above_m[own, 2],
        seen_m=points_m[:, :2],
        off_m=points_m[own, 2] - planes_m[:, 0],
        true_off_m=truth_m[own, 2] - planes_m[:, 1],
        sigma_m=np.hypot(sigma_m[own], planes_m[:, 2]),
        spacing_m=np.concatenate([steps_m[:1], steps_m])[valid][own],
        **_slopes(measurement, true_m),
    )


def bands_of(cloud: Cloud) -> list[Band]:
    """Compute the statistics of each octave of altitude, from the highest down."""
    octave = np.floor(np.log2(np.maximum(cloud.altitude_m, 1.0))).astype(np.int64)
    slope_octave = np.floor(np.log2(np.maximum(cloud.slope_altitude_m, 1.0))).astype(np.int64)
    bands = (_band(cloud, int(k), octave == k, slope_octave == k) for k in np.unique(octave)[::-1])
    return list(bands)


def touched_shares(cloud: Cloud) -> FloatArray:
    """(circles, boulders) Share of a circle's area in which a boulder would have a point on it.

    The circles of radii `CIRCLES_M` lie about the origin; the boulders' diameters are `BOULDERS_M`.
    """
    # A sunflower lattice covers a disc evenly and deterministically.
    number = np.arange(_PLACES) + 0.5
    radius, turn = np.sqrt(number / _PLACES), np.pi * (1 + np.sqrt(5)) * number
    places = np.stack([radius * np.sin(turn), radius * np.cos(turn)], axis=-1)
    tree = cKDTree(cloud.seen_m)
    away_m = np.stack([tree.query(circle_m * places)[0] for circle_m in CIRCLES_M])
    return np.asarray((away_m[..., None] < np.array(BOULDERS_M) / 2).mean(axis=1))


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
    cells = np.floor(east_north_m[::-1] / _CELL_M).astype(np.int64)
    _, from_last = np.unique(cells, axis=0, return_index=True)
    return np.asarray(len(cells) - 1 - from_last)


def _plane(points_m: FloatArray, truth_m: FloatArray, sigma_m: FloatArray, ring: _Ring) -> FloatArray:
    """Evaluate the plane through a ring at its centre: measured height, true height, and sigma of the measured one.

    Points on a line do not determine the slope across it, which is then taken as zero.
    """
    design = np.column_stack([np.ones(len(ring.others)), ring.offset_m / OUTER_M])
    weight = np.linalg.pinv(design, rcond=_LEAST_SPREAD)[0]
    heights_m = points_m[ring.others, 2], truth_m[ring.others, 2]
    measured_m, true_m = (float((weight * height_m).sum()) for height_m in heights_m)
    return np.array([measured_m, true_m, np.sqrt(((weight * sigma_m[ring.others]) ** 2).sum())])


def _slopes(measurement: Measurement, true_m: FloatArray) -> dict[str, FloatArray]:
    seen = measurement.range_valid & np.isfinite(true_m[..., 2])
    if measurement.beam_count < 3:
        seen = np.zeros_like(seen)
    shots = np.flatnonzero(seen.sum(axis=1) >= 3)
    points_m, truth_m = measurement.point_site_m[shots], true_m[shots]
    weight = seen[shots].astype(float)
    known_m = np.where(weight[..., None] > 0, truth_m, 0.0)
    centre_m = known_m.sum(axis=1) / weight.sum(axis=1)[:, None]
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


_SIZE_INCH = (16.0, 11.0)
_LEAST_HEIGHT_M = 1e-3
"""Lower end of the axis of heights; smaller heights are drawn there."""


def plot_hazards(cloud: Cloud, bands: Sequence[Band], shares: FloatArray, title: str, path: Path) -> None:
    """Plot a PNG of 1600 by 1100 pixels.

    Args:
        cloud: points of a flight.
        bands: statistics of the points by altitude.
        shares: (circles, boulders) shares of boulders with a point, as of `touched_shares`.
        title: title of the figure.
        path: file, `.png`, `.svg` or `.pdf`.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    write_plot(draw_hazards(cloud, bands, shares, title), path)


def draw_hazards(cloud: Cloud, bands: Sequence[Band], shares: FloatArray, title: str) -> Figure:
    """Draw the figure of `plot_hazards`."""
    figure = titled_figure(title, _SIZE_INCH, 17)
    (heights, detection), (slopes, boulders) = figure.subplots(2, 2)
    _draw_heights(heights, cloud, bands)
    _draw_detection(detection, bands)
    _draw_slopes(slopes, cloud, bands)
    _draw_boulders(boulders, shares)
    for axes in (heights, detection, slopes, boulders):
        axes.grid(alpha=0.3)
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), frameon=False)
    return figure


def _draw_heights(axes: Axes, cloud: Cloud, bands: Sequence[Band]) -> None:
    height_m = np.maximum(np.abs(cloud.true_off_m), _LEAST_HEIGHT_M)
    for chosen, colour, label in (
        (~cloud.stands_out, "0.6", "not detected"),
        (cloud.stands_out, "C3", "detected"),
    ):
        axes.plot(
            cloud.altitude_m[chosen], height_m[chosen], ".", color=colour, markersize=3.5,
            label=f"{label} ({chosen.sum()})",
        )  # fmt: skip
    middle_m, from_m = [band.middle_m for band in bands], [band.detected_from_m for band in bands]
    axes.plot(middle_m, from_m, "k.-", linewidth=1.0, label="nine in ten\ndetected above")
    axes.set(
        xscale="log", yscale="log", xlabel="altitude (m)", ylabel="true height off the surroundings (m)",
        title=f"points; detected: {SIGMAS:g} sigma off the plane through their neighbours",
    )  # fmt: skip


def _draw_detection(axes: Axes, bands: Sequence[Band]) -> None:
    found = [(band.middle_m, band.detected, band.higher) for band in bands]
    false = [(band.middle_m, band.alarms, band.level) for band in bands]
    for label, colour, values in (
        ("detected, of the points\nabove the line on the left", "C3", found),
        ("false alarms, of the\nlevel points", "C0", false),
    ):
        known = [((at_m, 100.0 * share), count) for at_m, share, count in values if share is not None]
        axes.plot(*np.array([place for place, _ in known]).reshape(-1, 2).T, "o-", color=colour, label=label)
        for place, count in known:
            axes.annotate(
                str(count), place, (0, 6), color=colour, fontsize=8, textcoords="offset points", ha="center"
            )
    axes.set(
        xscale="log", ylim=(-4, 108), xlabel="altitude (m)", ylabel="share of the points (%)",
        title="detection by altitude, with the number of points",
    )  # fmt: skip


def _draw_slopes(axes: Axes, cloud: Cloud, bands: Sequence[Band]) -> None:
    error_deg = np.abs(cloud.slope_deg - cloud.true_slope_deg)
    axes.plot(cloud.slope_altitude_m, error_deg, ".", color="0.6", markersize=3.5, label="error of a shot")
    middle_m = [band.middle_m for band in bands]
    for label, style, values in (
        ("rms error", "C3.-", [band.slope_error_deg for band in bands]),
        ("rms expected\nfrom stated sigma", "k.--", [band.slope_sigma_deg for band in bands]),
    ):
        axes.plot(middle_m, values, style, linewidth=1.2, label=label)
    axes.set(
        xscale="log", yscale="log", xlabel="altitude (m)", ylabel="error of the slope (deg)",
        title="slope of the plane through the beams of a shot",
    )  # fmt: skip


def _draw_boulders(axes: Axes, shares: FloatArray) -> None:
    for diameter_m, share in zip(BOULDERS_M, shares.T, strict=True):
        axes.plot(CIRCLES_M, 100.0 * share, "o-", label=f"{diameter_m:g} m across")
    axes.set(
        xscale="log", ylim=(0, None), xlabel="radius of the circle about the origin (m)",
        ylabel="boulders with a point on them (%)", title="boulders within a circle",
    )  # fmt: skip
