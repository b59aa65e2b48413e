"""One ground from several elevation grids: cropped to the reach of the run, nested, and refined."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scenario import site
from lidar_emu.scenario.ground import Detail, Generated
from lidar_emu.scene.analytic_grounds import PlaneGround, SphereGround
from lidar_emu.scene.grid.cell import BILINEAR, Samples, surface
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.mosaic.nested import extent, nest
from lidar_emu.scene.ray_hits import GROUND, Hits, RayCaster, Scene
from lidar_emu.scene.ray_reach import CroppedGrid, CroppedGround, Reach, Rectangle, Span
from lidar_emu.scene.terrain.model import Terrain


@kernel(outermost=True)
def _paint(
    origin: FloatArray,
    direction: FloatArray,
    range_m: FloatArray,
    object_id: NDArray[np.int16],
    share: FloatArray,
    place: FloatArray,
    reflectance: FloatArray,
) -> None:
    west, south, columns_per_m, rows_per_m, first_column, first_row = place
    for k in range(range_m.shape[0]):
        if object_id[k] != GROUND:
            continue
        u = (origin[k, 0] + range_m[k] * direction[k, 0] - west) * columns_per_m - first_column
        v = (origin[k, 1] + range_m[k] * direction[k, 1] - south) * rows_per_m - first_row
        if 0.0 <= u <= share.shape[1] - 1 and 0.0 <= v <= share.shape[0] - 1:
            found = surface(share, BILINEAR, u, v)
            if found == found:
                reflectance[k] = found


class PaintedGround(RayCaster):
    """A ground with the albedo of a map, bilinear between samples, and its own where the map has none.

    Args:
        ground: ground that is hit.
        albedo: (rows, columns) albedo of the whole map, 0 to 1, rows from south to north; NaN where missing.
        samples: heights of the map, whose rows and columns are used.
    """

    def __init__(self, ground: Scene, albedo: FloatArray, samples: Samples) -> None:
        rows, columns = samples.height_m.shape
        first_row, first_column = samples.first_row, samples.first_column
        self.ground = ground
        self._share = albedo[first_row : first_row + rows, first_column : first_column + columns].copy()
        self.description, self.origin_altitude_m = ground.description, ground.origin_altitude_m
        self.height_m, self.covers = ground.height_m, ground.covers
        self._place = np.array(
            [
                samples.west_m,
                samples.south_m,
                1 / samples.pixel_east_m,
                1 / samples.pixel_north_m,
                first_column,
                first_row,
            ]
        )

    def _fill(self, origin: FloatArray, direction: FloatArray, hits: Hits, bundle: int) -> None:
        self.ground.cast(origin, direction, hits, bundle)
        _paint(origin, direction, hits.range_m, hits.object_id, self._share, self._place, hits.reflectance)


CUT_FROM_SAMPLES = 1_000_000
"""Grids with fewer samples stay whole: cropping would save little."""
MARGIN = 12
"""Margin of rows and columns around what rays need, on which detail and its seam depend."""
FEATHER_PIXELS = 4

Beyond = PlaneGround | SphereGround | None


@dataclass(frozen=True)
class Layer:
    """One whole grid of a ground."""

    samples: Samples
    build: Callable[[Samples, Beyond, str], GridGround]
    """Builds a ground of the grid's kind from samples, the ground beyond and a description."""
    description: str
    """One line for plans."""
    source: str
    """File of the grid."""
    detail: Detail | None = None
    albedo: FloatArray | None = None
    """(rows, columns) Albedo of the samples, if the file has it; NaN where missing."""

    @property
    def pixel_m(self) -> float:
        """Longer side of a pixel."""
        return max(self.samples.pixel_east_m, self.samples.pixel_north_m)

    def alone(self, samples: Samples, description: str) -> GridGround:
        """Ground of samples with nothing beyond."""
        return self.build(samples, None, description)


def join_grids(
    read: Callable[[], tuple[Sequence[Layer], Beyond]],
    reach: Reach | None,
    cut: bool = True,
) -> Scene:
    """Join grids to one ground.

    Args:
        read: reads the grids, from the finest to the widest, and the ground around all of them; called again if a
            cropped ground must be restored.
        reach: rays of the run; None: unknown.
        cut: whether to leave out what they cannot reach.
    """
    layers, beyond = read()
    spans = _spans(layers, beyond)
    cropped: list[CroppedGrid] = []
    painted: list[tuple[FloatArray, Samples]] = []
    ground: Scene | None = None
    for place, layer in reversed(list(enumerate(layers))):
        span = spans[place]
        samples = replace(layer.samples, bounds_m=(span.floor_m, span.ceiling_m))
        if cut and reach is not None and samples.height_m.size >= CUT_FROM_SAMPLES:
            samples = _part(samples, reach.over(span))
            cropped.append(
                CroppedGrid(span, extent(samples), layer.samples.height_m.size, samples.height_m.size)
            )
        if ground is None:
            ground = base = layer.build(samples, beyond, layer.description)
        else:
            inner = partial(layer.alone, description=layer.description)
            ground = nest(samples, span.area, ground, _feather_m(span.area, layers[place + 1]), inner)
            base = ground.inner
        if layer.albedo is not None:
            painted.append((layer.albedo, samples))
        if layer.detail is not None:
            ground = _with_detail(ground, base.samples, layer, layer.detail, span, reach)
    assert ground is not None
    for albedo, samples in painted:
        ground = PaintedGround(ground, albedo, samples)
    if not cropped:
        return ground
    build_whole = partial(join_grids, read, reach, cut=False)
    return CroppedGround(ground, tuple(cropped), build_whole)


def _spans(layers: Sequence[Layer], beyond: Beyond) -> list[Span]:
    """Span of each grid; the heights bound all of them, since neighbouring grids are blended."""
    bounds_m = [layer.samples.bounds_with(beyond) for layer in layers]
    floor_m, ceiling_m = min(low for low, _ in bounds_m), max(high for _, high in bounds_m)
    return [Span(extent(layer.samples), floor_m, ceiling_m) for layer in layers]


def _part(samples: Samples, needed: Rectangle) -> Samples:
    """The rows and columns of a part of the area, with a margin, as a copy, so that the rest can be released."""
    rows, columns = samples.within(needed, MARGIN)
    return replace(
        samples,
        height_m=samples.height_m[rows.start : rows.stop, columns.start : columns.stop].copy(),
        first_row=rows.start,
        first_column=columns.start,
    )


def _feather_m(area: Rectangle, wider: Layer) -> float:
    side_m = min(area.east_m - area.west_m, area.north_m - area.south_m)
    return min(FEATHER_PIXELS * wider.pixel_m, side_m / 4)


def _with_detail(
    ground: Scene, base: Samples, layer: Layer, part: Detail, span: Span, reach: Reach | None
) -> Scene:
    from lidar_emu.scene.mosaic.detail import detailed

    needed = span.area
    if reach is not None:
        needed = reach.over(span) if part.below_m is None else reach.over(span, part.below_m)
    return detailed(ground, base, layer.samples, needed, part, layer.source, layer.alone)


BODY_TOLERANCE = 0.01
"""Maximum relative difference of radius: maps of one body use spheres and ellipsoids that differ by up to 0.6 % (Mars).
"""


def read_layers(part: site.Site, grids: list[site.AnyGrid]) -> tuple[list[Layer], float]:
    """Read the grids of a site, and the height of its origin above the body's sphere."""
    first = _read(part, grids[0], None)
    altitude_m = first.origin_elevation_m if part.origin_altitude_m is None else part.origin_altitude_m
    terrains = [first, *(_read(part, grid, (grids[0], first)) for grid in grids[1:])]
    layers = [_layer(part, grid, terrain, altitude_m) for grid, terrain in zip(grids, terrains, strict=True)]
    _refuse_disorder(layers)
    widest = f"{layers[-1].description}; beyond: {grids[-1].beyond}"
    return [*layers[:-1], replace(layers[-1], description=widest)], altitude_m


def _refuse_disorder(layers: list[Layer]) -> None:
    for place, (before, layer) in enumerate(pairwise(layers), start=1):
        if layer.pixel_m < before.pixel_m * (1 - 1e-6):
            found = Finding(
                f"{layer.pixel_m:.6g} m from sample to sample after one of {before.pixel_m:.6g} m"
            )
            raise InputError(layer.source, f"ground.grids.{place}", found, "list the finest grid first")


def _layer(part: site.Site, grid: site.AnyGrid, terrain: Terrain, altitude_m: float) -> Layer:
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


def _read(part: site.Site, grid: site.AnyGrid, first: tuple[site.AnyGrid, Terrain] | None) -> Terrain:
    """Read a grid around its own origin; a later grid without origin or position takes the origin of the first."""
    if isinstance(grid, Generated):
        return _generated(grid)
    if first is not None and grid.at_m is None and grid.origin == site.Origin():
        grid = grid.model_copy(update={"origin": _origin_of(*first, grid.file)})
    from lidar_emu.scene.terrain.read import read_terrain

    terrain = read_terrain(grid)
    _check_body(part.body, terrain)
    return terrain


def _origin_of(grid: site.AnyGrid, terrain: Terrain, asker: str) -> site.Origin:
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
    from lidar_emu.scene.procedural.generate import elevation_m
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
