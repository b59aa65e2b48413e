"""From the site of a scenario to its ground."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from lidar_emu.errors import InputError
from lidar_emu.scenario import site
from lidar_emu.scenario.generated_ground import Generated
from lidar_emu.scenario.mesh_ground import Mesh
from lidar_emu.scene.hits import Scene

if TYPE_CHECKING:
    from lidar_emu.arrays import FloatArray
    from lidar_emu.scene.grid import Samples
    from lidar_emu.scene.plane import PlaneGround
    from lidar_emu.scene.sphere import SphereGround
    from lidar_emu.scene.terrain import Terrain

BODY_TOLERANCE = 0.01
"""Maps of one body are drawn on spheres and ellipsoids that differ by up to 0.6 % (Mars)."""


def build_scene(part: site.Site) -> Scene:
    """The ground of a site with its objects, in the site frame.

    Raises:
        InputError: an elevation file or a mesh cannot be used as the site asks.
    """
    ground = _ground(part)
    if not part.objects:
        return ground
    from lidar_emu.scene.objects import populated

    return populated(ground, part)


def _ground(part: site.Site) -> Scene:
    if isinstance(part.ground, site.Grid):
        from lidar_emu.scene.terrain_read import read_terrain

        return _grid(part, part.ground, read_terrain(part.ground))
    if isinstance(part.ground, Generated):
        # What was made is a grid like any other, with the origin at its centre.
        shared = part.ground.model_dump(include={"interpolation", "beyond"})
        as_grid = site.Grid(kind="grid", file="generated", **shared)
        return _grid(part, as_grid, _generated_terrain(part.ground, as_grid))
    if isinstance(part.ground, site.Plane):
        return _plane(part, part.ground, part.origin_altitude_m or 0.0)
    if isinstance(part.ground, Mesh):
        from lidar_emu.scene.mesh_file import read_mesh
        from lidar_emu.scene.mesh_ground import place_mesh

        return place_mesh(read_mesh(part.ground.file, part.ground.unit), part.ground.origin, part)
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

    _check_body(part.body, terrain)
    altitude_m = terrain.origin_elevation_m if part.origin_altitude_m is None else part.origin_altitude_m
    samples = Samples(
        # Files run from north to south, the site frame from south to north.
        height_m=(terrain.elevation_m - altitude_m)[::-1].copy(),
        west_m=terrain.west_m,
        south_m=terrain.north_m - terrain.pixel_north_m * (len(terrain.elevation_m) - 1),
        pixel_east_m=terrain.pixel_east_m,
        pixel_north_m=terrain.pixel_north_m,
        interpolation=ground.interpolation,
    )
    around = {
        "none": None,
        "plane": _plane(part, site.Plane(kind="plane"), altitude_m),
        # Through the origin, as the level plane is: the body's sphere at the height of the site.
        "sphere": _sphere(part, part.body.radius_m + altitude_m, 0.0),
    }
    description = f"{terrain.description}; beyond: {ground.beyond}"
    scene = GridGround(samples, around[ground.beyond], description, altitude_m, part.surface.reflectance)
    return scene if terrain.reflectance is None else _painted(scene, samples, terrain.reflectance)


def _painted(scene: Scene, samples: Samples, reflectance: FloatArray) -> Scene:
    """With the albedo that the file has for the samples."""
    from lidar_emu.scene.albedo import Albedo, PaintedGround

    albedo = Albedo(
        share=reflectance[::-1].copy(),
        west_m=samples.west_m,
        south_m=samples.south_m,
        pixel_east_m=samples.pixel_east_m,
        pixel_north_m=samples.pixel_north_m,
    )
    return PaintedGround(scene, albedo)


def _check_body(body: site.Body, terrain: Terrain) -> None:
    """Refuse the map of another body, such as Mars on the Moon that a site is on unless it says otherwise."""
    if terrain.frame is None:
        return
    radius_m = terrain.frame.ellipsoid.equatorial_m
    if abs(radius_m / body.radius_m - 1) > BODY_TOLERANCE:
        allowed = f"allowed: that of the map within {BODY_TOLERANCE:.0%}, {radius_m:.10g} m"
        raise InputError(terrain.source, "site.body.radius_m", body.radius_m, allowed)


def _generated_terrain(ground: Generated, as_grid: site.Grid) -> Terrain:
    import numpy as np

    from lidar_emu.ground.kept import elevation_m
    from lidar_emu.scene.terrain_flat import FlatMap, placed_flat

    half_m, spacing_m = ground.size_m / 2, ground.size_m / ground.cells
    flat = FlatMap(
        elevation_m=elevation_m(ground).astype(np.float64),
        first_x_m=-half_m,
        first_y_m=half_m,
        pixel_x_m=spacing_m,
        pixel_y_m=spacing_m,
        source=f"generated (seed {ground.seed})",
    )
    return placed_flat(flat, as_grid)
