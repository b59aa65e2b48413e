"""From the site of a scenario to its ground."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from lidar_emu.errors import Finding, InputError
from lidar_emu.scenario import site
from lidar_emu.scenario.generated_ground import Generated
from lidar_emu.scene.hits import Scene

if TYPE_CHECKING:
    from lidar_emu.scene.plane import PlaneGround
    from lidar_emu.scene.sphere import SphereGround
    from lidar_emu.scene.terrain import Terrain


def build_scene(part: site.Site) -> Scene:
    """The ground of a site, in the site frame.

    Raises:
        InputError: an elevation file cannot be used as the site asks.
    """
    if isinstance(part.ground, site.Grid):
        return _grid(part, part.ground, read_terrain(part.ground))
    if isinstance(part.ground, Generated):
        # What was made is a grid like any other, with the origin at its centre.
        as_grid = site.Grid(kind="grid", file="generated", beyond=part.ground.beyond)
        return _grid(part, as_grid, _generated_terrain(part.ground))
    if isinstance(part.ground, site.Plane):
        return _plane(part, part.ground, part.origin_altitude_m or 0.0)
    return _sphere(part, part.body.radius_m, part.origin_altitude_m or 0.0)


def _plane(part: site.Site, ground: site.Plane, origin_altitude_m: float) -> PlaneGround:
    from lidar_emu.scene.plane import PlaneGround

    azimuth_rad = math.radians(ground.downhill_azimuth_deg)
    slope_rad = math.radians(ground.slope_deg)
    return PlaneGround(slope_rad, azimuth_rad, origin_altitude_m, part.surface.reflectance)


def _sphere(part: site.Site, radius_m: float, origin_altitude_m: float) -> SphereGround:
    from lidar_emu.scene.sphere import SphereGround

    return SphereGround(radius_m, origin_altitude_m, part.surface.reflectance)


def _grid(part: site.Site, ground: site.Grid, terrain: Terrain) -> Scene:
    from lidar_emu.scene.grid import GridGround, Samples
    from lidar_emu.scene.terrain_origin import origin_of

    origin = origin_of(terrain, ground)
    altitude_m = origin.elevation_m if part.origin_altitude_m is None else part.origin_altitude_m
    samples = Samples(
        # Files run from north to south, the site frame from south to north.
        height_m=(terrain.elevation_m - altitude_m)[::-1].copy(),
        west_m=terrain.first_x_m - origin.map_x_m,
        south_m=terrain.last_y_m - origin.map_y_m,
        pixel_east_m=terrain.pixel_x_m,
        pixel_north_m=terrain.pixel_y_m,
    )
    around = {
        "none": None,
        "plane": _plane(part, site.Plane(kind="plane"), altitude_m),
        # Through the origin, as the level plane is: the body's sphere at the height of the site.
        "sphere": _sphere(part, part.body.radius_m + altitude_m, 0.0),
    }
    description = f"{terrain.description}; beyond: {ground.beyond}"
    return GridGround(samples, around[ground.beyond], description, altitude_m, part.surface.reflectance)


def _generated_terrain(ground: Generated) -> Terrain:
    import numpy as np

    from lidar_emu.ground.kept import elevation_m
    from lidar_emu.scene.terrain import Terrain

    half_m, spacing_m = ground.size_m / 2, ground.size_m / ground.cells
    return Terrain(
        elevation_m=elevation_m(ground).astype(np.float64),
        first_x_m=-half_m,
        first_y_m=half_m,
        pixel_x_m=spacing_m,
        pixel_y_m=spacing_m,
        source=f"generated (seed {ground.seed})",
    )


def read_terrain(ground: site.Grid) -> Terrain:
    """The elevation file of a site.

    Raises:
        InputError: the file is not there, cannot be read, or is no elevation grid in metres with north up.
    """
    if not Path(ground.file).is_file():
        raise InputError(
            ground.file, None, Finding("no such file"), "allowed: GeoTIFF, ESRI ASCII grid or .npz"
        )
    if ground.file.lower().endswith(".npz"):
        from lidar_emu.scene.terrain_npz import read_npz

        return read_npz(ground)
    from lidar_emu.scene.terrain_raster import read_raster

    return read_raster(ground)
