"""Grids that follow the body: the part of a map around the site, in a frame tangent to the body there.

The height of a node is where the vertical through it intersects the ground of the file. It is found by iteration: a
height is assumed, converted to a position on the body and on the map, and corrected by the difference to the file's
elevation there. The error decreases in each of two to five iterations by the slope of the ground times the distance
from the origin over the body's radius.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.site import ElevationGrid
from lidar_emu.scene.ray_reach import Rectangle
from lidar_emu.scene.terrain.flat import ON_GROUND
from lidar_emu.scene.terrain.map import MapSamples, RasterMap, read_window, window_of
from lidar_emu.scene.terrain.model import LocalFrame, Terrain, check_size, height_range, refuse_nothing
from lidar_emu.scene.terrain.raster import band_number, elevations_m, other_bands, shares

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
    height_m = np.empty((len(north_m), len(east_m)))
    values = {name: np.empty_like(height_m) for name in others}
    at_once = max(1, _NODES_AT_ONCE // len(east_m))
    for first in range(0, len(north_m), at_once):
        rows = slice(first, first + at_once)
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


SAMPLES_TO_EACH_SIDE = 1000
"""Default distance from the origin to the edge of a grid."""
SHARE_OF_RADIUS = 0.1
"""Maximum distance, as a fraction of the body's radius."""


def read_on_body(ground: ElevationGrid, file: Any) -> Terrain:
    """Read the part of an open raster file around the site, in the site frame.

    Args:
        ground: the scenario's keys of the file.
        file: the open file, which states a projection.
    """
    raster = RasterMap(ground, file)
    band = band_number(ground.file, file, "band", ground.band)
    frame = _frame(ground, raster, file, band)
    at = raster.sample_at(np.array([frame.latitude_rad]), np.array([frame.longitude_rad]), raster.columns / 2)
    column, row = float(at[0][0]), float(at[1][0])
    steps_m = _steps_m(raster, frame, column, row)
    spacing_m = _spacing_m(steps_m)
    extent = _extent(ground, raster, frame, spacing_m)
    # The sample next to the origin is a node, so that a grid along the meridians is unchanged there.
    east_m = _nodes(float(steps_m[0, 0]), spacing_m, extent.west_m, extent.east_m)
    north_m = _nodes(float(steps_m[0, 1]), spacing_m, extent.south_m, extent.north_m)[::-1]
    check_size(ground.file, len(north_m), len(east_m))
    window = window_of(raster, *_spread(raster, frame, extent, column), column, _has_pole(frame, extent))
    samples = read_window(raster, window, partial(elevations_m, ground, file, band))
    refuse_nothing(ground.file, samples.values)
    surface = MapSurface(raster, frame, samples, column)
    others = {
        name: read_window(raster, window, partial(shares, ground, file, name, number))
        for name, number in other_bands(ground, file).items()
    }
    return resampled(surface, others, east_m, north_m)


def _frame(ground: ElevationGrid, raster: RasterMap, file: Any, band: int) -> LocalFrame:
    place, latitude, longitude = _origin(ground, raster)
    column, row = raster.sample_at(latitude, longitude, raster.columns / 2)
    north, south = raster.pole_rows
    in_columns = raster.is_closed or -0.5 <= column[0] <= raster.columns - 0.5
    if not (in_columns and -0.5 - north <= row[0] <= raster.rows - 0.5 + south):
        raise InputError(
            ground.file, "ground.origin", Finding(f"{place}, off the grid"), f"use {_area(raster)}"
        )
    window = window_of(raster, column, row, float(column[0]), around_pole=False)
    samples = read_window(raster, window, partial(elevations_m, ground, file, band))
    altitude_m = float(samples.at(column, row)[0])
    if np.isnan(altitude_m):
        found = Finding(f"{place}, where samples are missing")
        raise InputError(ground.file, "ground.origin", found, ON_GROUND)
    ellipsoid = raster.projection.ellipsoid
    if altitude_m > ellipsoid.polar_m / 2:
        found = Finding(f"elevations of {altitude_m:.7g} m, from the body's centre")
        remedy = f"make them heights with ground.elevation_offset_m: {-ellipsoid.equatorial_m:.10g}"
        raise InputError(ground.file, None, found, remedy)
    return LocalFrame(ellipsoid, float(latitude[0]), float(longitude[0]), altitude_m)


def _origin(ground: ElevationGrid, raster: RasterMap) -> tuple[str, FloatArray, FloatArray]:
    """The origin of the site frame, as text, and its latitude and longitude (1,); NaN off the body."""
    origin = ground.origin
    if origin.latitude_deg is not None and origin.longitude_deg is not None:
        found = f"latitude {origin.latitude_deg:g}, longitude {origin.longitude_deg:g}"
        latitude = raster.projection.normal_angle(np.radians([origin.latitude_deg]))
        return found, latitude, np.radians([origin.longitude_deg])
    if origin.map_x_m is not None and origin.map_y_m is not None:
        found = f"map x {origin.map_x_m:.9g} m, y {origin.map_y_m:.9g} m"
        place = np.array([origin.map_x_m]), np.array([origin.map_y_m])
        return found, *raster.projection.geodetic(*place)
    middle = np.array([(raster.columns - 1) / 2]), np.array([(raster.rows - 1) / 2])
    return "the grid's centre", *raster.geodetic(*middle)


def _area(raster: RasterMap) -> str:
    latitude, longitude = (np.degrees(angle) for angle in raster.geodetic(*_outline(raster)))
    if np.isnan(latitude).any() or raster.is_closed:
        return "a point on the map of the file"
    return (
        f"latitude from {latitude.min():.6g} to {latitude.max():.6g}, "
        f"longitude from {longitude.min():.6g} to {longitude.max():.6g}"
    )


def _outline(raster: RasterMap) -> tuple[FloatArray, FloatArray]:
    way, rest = np.linspace(0.0, 1.0, 65), np.zeros(65)
    column = np.concatenate([way, way, rest, rest + 1]) * (raster.columns - 1)
    row = np.concatenate([rest, rest + 1, way, way]) * (raster.rows - 1)
    return column, row


def _steps_m(raster: RasterMap, frame: LocalFrame, column: float, row: float) -> FloatArray:
    """Positions (3, 3) in the site frame of the sample next to a point, of its neighbour in the row, and of its
    neighbour in the column."""
    column = float(np.clip(round(column), 0, raster.columns - 1))
    row = float(np.clip(round(row), 0, raster.rows - 1))
    right = 1 if column < raster.columns / 2 else -1
    below = 1 if row < raster.rows / 2 else -1
    places = np.array([column, column + right, column]), np.array([row, row, row + below])
    latitude, longitude = raster.geodetic(*places)
    return frame.place_m(latitude, longitude, np.full(3, frame.altitude_m))


def _spacing_m(steps_m: FloatArray) -> float:
    """The smaller of the distances to the next column and row, but at least half of the larger one.

    Towards the poles of a cylindrical map columns converge without carrying more information.
    """
    lengths = np.sqrt(np.sum((steps_m[1:] - steps_m[0]) ** 2, axis=1))
    return float(max(lengths.min(), lengths.max() / 2))


def _extent(ground: ElevationGrid, raster: RasterMap, frame: LocalFrame, spacing_m: float) -> Rectangle:
    radius_m = frame.ellipsoid.equatorial_m
    half_m = min(SAMPLES_TO_EACH_SIDE * spacing_m, SHARE_OF_RADIUS * radius_m)
    if ground.half_size_m is not None:
        half_m = ground.half_size_m
        if half_m > radius_m / 2:
            remedy = f"must be at most {radius_m / 2:g}, half of the body's radius"
            raise InputError(ground.file, "ground.half_size_m", half_m, remedy)
    wanted = Rectangle(-half_m, half_m, -half_m, half_m)
    latitude, longitude = raster.geodetic(*_outline(raster))
    east, north, up = frame.place_m(latitude, longitude, np.full_like(latitude, frame.altitude_m)).T
    if raster.is_closed or not (up > -radius_m / 2).all():
        # The extent runs around the body.
        return wanted
    return Rectangle(
        max(wanted.west_m, float(east.min())),
        min(wanted.east_m, float(east.max())),
        max(wanted.south_m, float(north.min())),
        min(wanted.north_m, float(north.max())),
    )


def _nodes(through_m: float, spacing_m: float, first_m: float, last_m: float) -> FloatArray:
    # Rounding may move the sample at the edge of a file off it, and back.
    first = np.ceil((first_m - through_m) / spacing_m - 1e-6)
    last = np.floor((last_m - through_m) / spacing_m + 1e-6)
    return np.asarray(through_m + spacing_m * np.arange(first, last + 1))


def _spread(
    raster: RasterMap, frame: LocalFrame, extent: Rectangle, near_column: float
) -> tuple[FloatArray, FloatArray]:
    lattice = np.meshgrid(
        np.linspace(extent.west_m, extent.east_m, 17), np.linspace(extent.south_m, extent.north_m, 17)
    )
    east, north = (place.ravel() for place in lattice)
    radius_m = frame.ellipsoid.equatorial_m
    level = -(east**2 + north**2) / (2 * radius_m)
    places = [
        raster.sample_at(*frame.geodetic(east, north, level + share * radius_m)[:2], near_column)
        for share in (-0.01, 0.01)
    ]
    column, row = np.concatenate(places, axis=1)
    return column, row


def _has_pole(frame: LocalFrame, extent: Rectangle) -> bool:
    poles = frame.place_m(np.radians([90.0, -90.0]), np.zeros(2), np.zeros(2))
    east, north, up = poles[:, 0], poles[:, 1], poles[:, 2]
    width, height = extent.east_m - extent.west_m, extent.north_m - extent.south_m
    in_width = (extent.west_m - width < east) & (east < extent.east_m + width)
    in_height = (extent.south_m - height < north) & (north < extent.north_m + height)
    return bool((in_width & in_height & (up > -frame.ellipsoid.polar_m)).any())
