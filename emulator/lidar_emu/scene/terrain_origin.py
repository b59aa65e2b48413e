"""Where on the map the origin of the site frame lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lidar_emu.errors import InputError
from lidar_emu.scenario.site import Grid
from lidar_emu.scene.terrain import Terrain


@dataclass(frozen=True)
class MapPoint:
    """A point of the map, and the elevation there."""

    map_x_m: float
    map_y_m: float
    elevation_m: float


def origin_of(terrain: Terrain, ground: Grid) -> MapPoint:
    """The point of the map that becomes the origin of the site frame.

    Raises:
        InputError: it lies outside the grid or where samples are missing, or the file states no such map.
    """
    x_m, y_m = _map_coordinates(terrain, ground)
    found = f"map x {x_m:.9g} m, y {y_m:.9g} m"
    if not (terrain.first_x_m <= x_m <= terrain.last_x_m and terrain.last_y_m <= y_m <= terrain.first_y_m):
        area = (
            f"x from {terrain.first_x_m:.9g} to {terrain.last_x_m:.9g} m, "
            f"y from {terrain.last_y_m:.9g} to {terrain.first_y_m:.9g} m"
        )
        raise InputError(terrain.source, "ground.origin", found, f"it is off the grid; allowed: {area}")
    elevation_m = _bilinear(terrain, x_m, y_m)
    if np.isnan(elevation_m):
        allowed = "samples are missing there; allowed: a point on the ground"
        raise InputError(terrain.source, "ground.origin", found, allowed)
    return MapPoint(x_m, y_m, elevation_m)


def _map_coordinates(terrain: Terrain, ground: Grid) -> tuple[float, float]:
    origin = ground.origin
    centre = "or none for the grid's centre"
    if origin.latitude_deg is not None and origin.longitude_deg is not None:
        if terrain.projection is None:
            allowed = f"no projection is stated; allowed: map_x_m and map_y_m, {centre}"
            raise InputError(terrain.source, "ground.origin.latitude_deg", origin.latitude_deg, allowed)
        from lidar_emu.scene.terrain_raster import project

        return project(terrain, origin.latitude_deg, origin.longitude_deg)
    if origin.map_x_m is not None and origin.map_y_m is not None:
        if not terrain.has_map:
            allowed = f"no map is stated; allowed: a file with map_x_m and map_y_m, {centre}"
            raise InputError(terrain.source, "ground.origin.map_x_m", origin.map_x_m, allowed)
        return origin.map_x_m, origin.map_y_m
    return (terrain.first_x_m + terrain.last_x_m) / 2, (terrain.first_y_m + terrain.last_y_m) / 2


def _bilinear(terrain: Terrain, x_m: float, y_m: float) -> float:
    """Elevation between four samples; NaN where one is missing."""
    rows, columns = terrain.elevation_m.shape
    across = (x_m - terrain.first_x_m) / terrain.pixel_x_m
    down = (terrain.first_y_m - y_m) / terrain.pixel_y_m
    column, row = min(int(across), columns - 2), min(int(down), rows - 2)
    a, b = across - column, down - row
    (z00, z10), (z01, z11) = terrain.elevation_m[row : row + 2, column : column + 2].tolist()
    return float((z00 * (1 - a) + z10 * a) * (1 - b) + (z01 * (1 - a) + z11 * a) * b)
