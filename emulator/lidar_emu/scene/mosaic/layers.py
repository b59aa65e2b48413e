"""Reading of a site's grids: their samples in the site frame."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.scenario import site
from lidar_emu.scenario.generated_ground import Generated
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.grid.samples import Samples
from lidar_emu.scene.mosaic.grids import Beyond, Layer
from lidar_emu.scene.terrain.model import Terrain

BODY_TOLERANCE = 0.01
"""Maximum relative difference of radius: maps of one body use spheres and ellipsoids that differ by up to 0.6 % (Mars).
"""

AnyGrid = site.ElevationGrid | Generated


def read_layers(part: site.Site, grids: list[AnyGrid]) -> tuple[list[Layer], float]:
    """Read the grids of a site, and the height of its origin above the body's sphere."""
    first = _read(part, grids[0], None)
    altitude_m = first.origin_elevation_m if part.origin_altitude_m is None else part.origin_altitude_m
    terrains = [first, *(_read(part, grid, (grids[0], first)) for grid in grids[1:])]
    layers = [_layer(part, grid, terrain, altitude_m) for grid, terrain in zip(grids, terrains, strict=True)]
    _refuse_disorder(layers)
    widest = f"{layers[-1].description}; beyond: {grids[-1].beyond}"
    return [*layers[:-1], replace(layers[-1], description=widest)], altitude_m


def _refuse_disorder(layers: list[Layer]) -> None:
    """Refuse a grid that is finer than the preceding one, which would hide it."""
    for place, (before, layer) in enumerate(pairwise(layers), start=1):
        if layer.pixel_m < before.pixel_m * (1 - 1e-6):
            found = Finding(
                f"{layer.pixel_m:.6g} m from sample to sample after one of {before.pixel_m:.6g} m"
            )
            raise InputError(layer.source, f"ground.grids.{place}", found, "list the finest grid first")


def _layer(part: site.Site, grid: AnyGrid, terrain: Terrain, altitude_m: float) -> Layer:
    east_m, north_m = grid.at_m or (0.0, 0.0)
    samples = Samples(
        # Files run from north to south, the site frame from south to north.
        height_m=(terrain.elevation_m - altitude_m)[::-1].copy(),
        west_m=terrain.west_m + east_m,
        south_m=terrain.north_m - terrain.pixel_north_m * (len(terrain.elevation_m) - 1) + north_m,
        pixel_east_m=terrain.pixel_east_m,
        pixel_north_m=terrain.pixel_north_m,
        interpolation=grid.interpolation,
    )

    def build(samples: Samples, beyond: Beyond, description: str) -> GridGround:
        return GridGround(samples, beyond, description, altitude_m, part.surface.reflectance)

    albedo = None if terrain.reflectance is None else terrain.reflectance[::-1]
    return Layer(samples, build, terrain.description, terrain.source, grid.detail, albedo)


def _read(part: site.Site, grid: AnyGrid, first: tuple[AnyGrid, Terrain] | None) -> Terrain:
    """Read a grid around its own origin; a later grid without origin or position takes the origin of the first."""
    if isinstance(grid, Generated):
        return _generated(grid)
    if first is not None and grid.at_m is None and grid.origin == site.Origin():
        grid = grid.model_copy(update={"origin": _origin_of(*first, grid.file)})
    from lidar_emu.scene.terrain.read import read_terrain

    terrain = read_terrain(grid)
    _check_body(part.body, terrain)
    return terrain


def _origin_of(grid: AnyGrid, terrain: Terrain, asker: str) -> site.Origin:
    """Origin of the first grid, for the map of another file."""
    if terrain.frame is not None:
        squash = terrain.frame.ellipsoid.polar_m / terrain.frame.ellipsoid.equatorial_m
        centric = math.atan(math.tan(terrain.frame.latitude_rad) * squash**2)
        longitude_deg = math.degrees(terrain.frame.longitude_rad)
        return site.Origin(latitude_deg=math.degrees(centric), longitude_deg=longitude_deg)
    if isinstance(grid, Generated) or grid.origin == site.Origin():
        found = Finding("no position relative to the first grid, which has no map projection")
        remedy = "state at_m, east and north of the site's origin, or an origin on the map of the first grid"
        raise InputError(asker, "ground.grids", found, remedy)
    return grid.origin


def _check_body(body: site.Body, terrain: Terrain) -> None:
    """Refuse the map of another body, for example of Mars for a site on the Moon, which is the default."""
    if terrain.frame is None:
        return
    radius_m = terrain.frame.ellipsoid.equatorial_m
    if abs(radius_m / body.radius_m - 1) > BODY_TOLERANCE:
        remedy = f"must be within {BODY_TOLERANCE:.0%} of {radius_m:.10g}, the radius of the map's body"
        raise InputError(terrain.source, "site.body.radius_m", body.radius_m, remedy)


def _generated(ground: Generated) -> Terrain:
    from lidar_emu.scene.generated.cache import elevation_m
    from lidar_emu.scene.terrain.flat import FlatMap, placed_flat

    half_m, spacing_m = ground.size_m / 2, ground.size_m / ground.cells
    flat = FlatMap(
        elevation_m=elevation_m(ground).astype(np.float64),
        first_x_m=-half_m,
        first_y_m=half_m,
        pixel_x_m=spacing_m,
        pixel_y_m=spacing_m,
        source=f"generated (seed {ground.seed})",
    )
    return placed_flat(flat, site.ElevationGrid(kind="grid", file="generated"))
