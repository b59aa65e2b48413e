"""The bounding box of a flight, and the ground in it, for plots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray

if TYPE_CHECKING:
    from lidar_emu.scene.ray_hits import Scene

_WIDEST_RATIO = 3.0
"""Largest ratio of the horizontal axes, so that a long approach stays readable."""
_STEEP = 0.995
"""Quantile of the slopes that is drawn darkest and brightest."""


@dataclass(frozen=True)
class Extent:
    """The plotted box in the site frame."""

    low_m: FloatArray
    """(3,) East, north, up."""
    high_m: FloatArray
    """(3,) East, north, up."""

    def contains(self, other: Extent) -> bool:
        """Whether the other box is inside."""
        return bool((self.low_m <= other.low_m).all() and (other.high_m <= self.high_m).all())


def extent_of(measurement: Measurement) -> Extent:
    """Compute the bounding box of path and hit points, with a margin and a least size.

    The hit points are the true ones of the beams that fired, which no fault displaces; without any, the measured ones.
    """
    hit = measurement.fired & np.isfinite(measurement.true_point_site_m[..., 2])
    known, points_m = (
        (hit, measurement.true_point_site_m)
        if hit.any()
        else (measurement.range_valid, measurement.point_site_m)
    )
    # Component by component: a copy of all points of an hour takes 35 MB.
    seen_m = (np.concatenate([measurement.position_site_m[:, k], points_m[..., k][known]]) for k in range(3))
    low_m, high_m = np.array([(np.nanmin(values), np.nanmax(values)) for values in seen_m]).T
    centre_m, half_m = (high_m + low_m) / 2, (high_m - low_m) / 2
    half_m[:2] = np.maximum(half_m[:2], max(half_m[:2].max() / _WIDEST_RATIO, 0.05 * half_m[2], 0.5)) * 1.08
    half_m[2] = max(half_m[2], 0.5) * 1.02
    return Extent(centre_m - half_m, centre_m + half_m)


def sample_ground(scene: Scene, extent: Extent, samples: int) -> FloatArray:
    """(n, n, 3) Sample points of the ground over the extent, rows to the north; up is NaN without ground."""
    axes_m = (np.linspace(extent.low_m[k], extent.high_m[k], samples) for k in range(2))
    east_m, north_m = np.meshgrid(*axes_m)
    up_m = scene.height_m(east_m.ravel(), north_m.ravel()).reshape(east_m.shape)
    return np.stack([east_m, north_m, up_m], axis=-1)


def slope_to_sun(ground_m: FloatArray) -> FloatArray:
    """(n-1, n-1) Slope of each quadrilateral toward the north-west, scaled to the steep ones: -1 to 1.

    Where elevation data end, a vertical face joins them to the level ground beyond; its slope is an artefact of the
    map's edge, and counts as level.
    """
    east_m, north_m, up_m = np.moveaxis(ground_m, -1, 0)
    rise_east = np.diff(up_m, axis=1)[:-1] / np.diff(east_m, axis=1)[:-1]
    rise_north = np.diff(up_m, axis=0)[:, :-1] / np.diff(north_m, axis=0)[:, :-1]
    facing: FloatArray = np.where(_touches_level(up_m), 0.0, rise_east - rise_north)
    known = np.abs(facing[np.isfinite(facing) & (facing != 0.0)])
    steep = float(np.quantile(known, _STEEP)) if known.size else 0.0
    # Slopes below one in a thousand are rounding errors on level ground.
    return np.asarray(np.clip(facing / max(steep, 1e-3), -1.0, 1.0))


def _touches_level(up_m: FloatArray) -> BoolArray:
    """(n-1, n-1) Whether a quadrilateral has a corner on exactly level ground."""
    corners = np.stack([up_m[:-1, :-1], up_m[:-1, 1:], up_m[1:, 1:], up_m[1:, :-1]])
    level = np.ptp(corners, axis=0) == 0.0
    on_level = np.zeros(up_m.shape, dtype=np.bool_)
    for rows in (slice(None, -1), slice(1, None)):
        for columns in (slice(None, -1), slice(1, None)):
            on_level[rows, columns] |= level
    return np.asarray(on_level[:-1, :-1] | on_level[:-1, 1:] | on_level[1:, 1:] | on_level[1:, :-1])
