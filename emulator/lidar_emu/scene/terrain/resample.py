"""Resampling of ground on a grid of the site frame.

The height of a node is where the vertical through it intersects the ground of the file. It is found by iteration: a
height is assumed, converted to a position on the body and on the map, and corrected by the difference to the file's
elevation there. The error decreases in each of two to five iterations by the slope of the ground times the distance
from the origin over the body's radius.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scene.terrain.frame import LocalFrame
from lidar_emu.scene.terrain.heights import height_range
from lidar_emu.scene.terrain.map import MapSamples, RasterMap
from lidar_emu.scene.terrain.model import Terrain, check_size, refuse_nothing

_TOLERANCE_M = 0.01
"""Maximum length of the last step; the remaining error is below a tenth of it, near the origin below a thousandth."""
_ROUNDS = 30
_NODES_AT_ONCE = 200_000
_PROBES = 20_000


@dataclass(frozen=True)
class MapSurface:
    """The ground of a file in the site frame."""

    raster: RasterMap
    frame: LocalFrame
    samples: MapSamples
    near_column: float
    """Column of the origin; see `RasterMap.sample_at`."""

    def height_m(self, east_m: FloatArray, north_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Height z (n,) of the ground, NaN where there is none, and the column and row of the file where it is
        found."""
        radius_m = self.frame.ellipsoid.equatorial_m
        z = -(east_m**2 + north_m**2) / (2 * radius_m)
        column, row = np.empty_like(z), np.empty_like(z)
        moving = np.arange(len(z))
        for _ in range(_ROUNDS):
            latitude, longitude, altitude = self.frame.geodetic(east_m[moving], north_m[moving], z[moving])
            at = self.raster.sample_at(latitude, longitude, self.near_column)
            column[moving], row[moving] = at
            step = self.samples.at(*at) - altitude
            z[moving] += step
            moving = moving[np.abs(step) > _TOLERANCE_M]
            if not len(moving):
                return z, column, row
        # A cliff that overhangs the vertical: the height is not unique.
        z[moving] = np.nan
        return z, column, row


def resampled(
    surface: MapSurface, others: dict[str, MapSamples], east_m: FloatArray, north_m: FloatArray
) -> Terrain:
    """Resample the surface and the other bands of its file at the nodes of a grid."""
    shape = len(north_m), len(east_m)
    height_m = np.empty(shape)
    values = {name: np.empty(shape) for name in others}
    for rows in _blocks(*shape):
        east, north = (place.ravel() for place in np.meshgrid(east_m, north_m[rows]))
        height, column, row = surface.height_m(east, north)
        height_m[rows] = height.reshape(-1, len(east_m))
        for name, samples in others.items():
            values[name][rows] = samples.at(column, row).reshape(-1, len(east_m))
    refuse_nothing(surface.raster.source, height_m)
    spacing_m = float(east_m[1] - east_m[0])
    terrain = Terrain(
        elevation_m=height_m + surface.frame.altitude_m,
        west_m=float(east_m[0]),
        north_m=float(north_m[0]),
        pixel_east_m=spacing_m,
        pixel_north_m=spacing_m,
        origin_elevation_m=surface.frame.altitude_m,
        source=surface.raster.source,
        frame=surface.frame,
        heights=height_range(surface.samples.values),
        placed=_error_in_words(surface, height_m, east_m, north_m),
        **values,
    )
    return _trimmed(terrain)


def _blocks(rows: int, columns: int) -> Iterator[slice]:
    step = max(1, _NODES_AT_ONCE // columns)
    for first in range(0, rows, step):
        yield slice(first, first + step)


def _error_in_words(
    surface: MapSurface, height_m: FloatArray, east_m: FloatArray, north_m: FloatArray
) -> str:
    """Maximum distance between the grid and the file's own bilinear surface, halfway between samples, as text."""
    step = max(1, int(np.sqrt(height_m.size / _PROBES)))
    row, column = (k.ravel() for k in np.mgrid[0 : len(north_m) - 1 : step, 0 : len(east_m) - 1 : step])
    between = (
        height_m[row, column]
        + height_m[row, column + 1]
        + height_m[row + 1, column]
        + height_m[row + 1, column + 1]
    ) / 4
    east, north = (east_m[column] + east_m[column + 1]) / 2, (north_m[row] + north_m[row + 1]) / 2
    error_m = between - surface.height_m(east, north)[0]
    error_m = error_m[np.isfinite(error_m)]
    if not error_m.size:
        return "placed on the body"
    rms_m, worst_m = np.sqrt(np.mean(error_m**2)), np.abs(error_m).max()
    return f"placed on the body, resampled within {rms_m:.2g} m rms, {worst_m:.2g} m at worst"


def _trimmed(terrain: Terrain) -> Terrain:
    """Remove the rows and columns at the edges in which every sample is missing."""
    known = ~np.isnan(terrain.elevation_m)
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    kept = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    shape = terrain.elevation_m[kept].shape
    check_size(terrain.source, *shape)
    return replace(
        terrain,
        elevation_m=terrain.elevation_m[kept],
        west_m=terrain.west_m + float(columns[0]) * terrain.pixel_east_m,
        north_m=terrain.north_m - float(rows[0]) * terrain.pixel_north_m,
        reflectance=None if terrain.reflectance is None else terrain.reflectance[kept],
        rock_abundance=None if terrain.rock_abundance is None else terrain.rock_abundance[kept],
    )
