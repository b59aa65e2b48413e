"""One ground from several elevation grids: cropped to the reach of the run, nested, and refined."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.ground_detail import Detail
from lidar_emu.scene.cropped_ground import CroppedGrid, CroppedGround
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.grid.samples import Samples
from lidar_emu.scene.map_area import Rectangle, indices_between
from lidar_emu.scene.mosaic.albedo import Albedo, PaintedGround
from lidar_emu.scene.mosaic.seam import extent, nest
from lidar_emu.scene.plane import PlaneGround
from lidar_emu.scene.ray_hits import Scene
from lidar_emu.scene.ray_reach import Reach, Span
from lidar_emu.scene.sphere import SphereGround

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
    albedos: list[Albedo] = []
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
            albedos.append(_albedo(samples, layer.albedo))
        if layer.detail is not None:
            ground = _with_detail(ground, base.samples, layer, layer.detail, span, reach)
    assert ground is not None
    for albedo in albedos:
        ground = PaintedGround(ground, albedo)
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
    count = samples.height_m.shape
    rows = indices_between(
        needed.south_m, needed.north_m, samples.south_m, samples.pixel_north_m, count[0], MARGIN
    )
    columns = indices_between(
        needed.west_m, needed.east_m, samples.west_m, samples.pixel_east_m, count[1], MARGIN
    )
    return replace(
        samples,
        height_m=samples.height_m[rows.start : rows.stop, columns.start : columns.stop].copy(),
        first_row=rows.start,
        first_column=columns.start,
    )


def _albedo(samples: Samples, share: FloatArray) -> Albedo:
    rows, columns = samples.height_m.shape
    first_row, first_column = samples.first_row, samples.first_column
    return Albedo(
        share=share[first_row : first_row + rows, first_column : first_column + columns].copy(),
        west_m=samples.west_m,
        south_m=samples.south_m,
        pixel_east_m=samples.pixel_east_m,
        pixel_north_m=samples.pixel_north_m,
        first_column=first_column,
        first_row=first_row,
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
