"""Ground and rays for comparing casters: one surface as a grid and as triangles, and the beams of a lander."""

from __future__ import annotations

from collections.abc import Callable
from math import pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.footprint import sample_footprint
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.ground import Interpolation
from lidar_emu.scene.grid.cell import Samples
from lidar_emu.scene.grid.ground import GridGround

BEAMLETS = 61
_PIXEL_M = 4.0
_WAIST_M, _WAVELENGTH_M = 0.025, 1.55e-6


FOUR_BEAMS = f"4 beams of {BEAMLETS}"


class Rays(NamedTuple):
    """Rays (n, 3), in bundles of equal size."""

    origin_m: FloatArray
    direction: FloatArray
    bundle: int


def rolling_ground(cells: int, interpolation: Interpolation) -> GridGround:
    """Hills of 40 m and roughness of 0.15 m, `cells` cells of 4 m along a side, around the origin."""
    rng = np.random.default_rng(1)
    place_m = _PIXEL_M * np.arange(cells + 1)
    hills_m = 40 * np.sin(place_m / 310) * np.cos(place_m / 230)[:, None]
    height_m = hills_m + rng.normal(0, 0.15, (cells + 1, cells + 1))
    half_m = _PIXEL_M * cells / 2
    return GridGround(Samples(height_m, -half_m, -half_m, _PIXEL_M, _PIXEL_M, interpolation), None, "", 0.0)


def triangles(samples: Samples) -> tuple[FloatArray, NDArray[np.int64]]:
    """Vertices (n, 3) and faces (m, 3) of the surface of `triangles`."""
    rows, columns = samples.height_m.shape
    east_m, north_m = np.meshgrid(samples.east_m, samples.north_m)
    vertex_m = np.stack([east_m, north_m, samples.height_m], axis=-1).reshape(-1, 3)
    number = np.arange(rows * columns).reshape(rows, columns)
    south_west, south_east = number[:-1, :-1].ravel(), number[:-1, 1:].ravel()
    north_west, north_east = number[1:, :-1].ravel(), number[1:, 1:].ravel()
    lower = np.stack([south_west, south_east, north_east], axis=1)
    return vertex_m, np.concatenate([lower, np.stack([south_west, north_east, north_west], axis=1)])


def beams(
    rng: np.random.Generator,
    tilt_rad: float,
    altitude_m: float,
    beamlets: int,
    count: int,
    along_edges: bool = False,
) -> Rays:
    """Beams of a shot, evenly around the vertical, from a place within 200 m of the middle: anywhere, or from above a
    vertex of the ground of 707 cells along the edges that meet there."""
    azimuth = 2 * pi * (np.arange(count) / count + (0.0 if along_edges else rng.random()))
    axis = np.stack(
        [
            np.sin(tilt_rad) * np.cos(azimuth),
            np.sin(tilt_rad) * np.sin(azimuth),
            np.full(count, -np.cos(tilt_rad)),
        ],
        axis=1,
    )
    east_m, north_m = (
        _PIXEL_M * (rng.integers(-50, 50, 2) + 0.5) if along_edges else rng.uniform(-200, 200, 2)
    )
    start = np.tile([east_m, north_m, altitude_m], (count, 1))
    range_m = np.full(count, altitude_m / np.cos(tilt_rad))
    footprint = sample_footprint(start, axis, range_m, beamlets, _WAIST_M, _WAVELENGTH_M)
    return Rays(footprint.start_site_m.reshape(-1, 3), footprint.ray_site.reshape(-1, 3), beamlets)


def unrelated(rng: np.random.Generator, count: int, altitude_m: float = 1000.0) -> Rays:
    """Rays down to anywhere near the middle, steeper than 45 degrees."""
    direction = np.column_stack([rng.uniform(-0.7, 0.7, (count, 2)), np.full(count, -1.0)])
    target = np.column_stack([rng.uniform(-400, 400, (count, 2)), np.zeros(count)])
    return Rays(target - altitude_m * direction, direction / np.linalg.norm(direction, axis=1)[:, None], 1)


def aimed_at_edges(rng: np.random.Generator, ground: GridGround, count: int) -> Rays:
    """Rays from above to vertices and to all three kinds of edges of triangles, well within the grid."""
    samples = ground.samples
    cells = len(samples.height_m) - 1
    place = rng.integers(cells // 8, cells - cells // 8, (count, 2)).astype(np.float64)
    share, kind = rng.random(count), rng.integers(0, 4, count)
    place[:, 0] += np.where((kind == 1) | (kind == 3), share, 0.0)
    place[:, 1] += np.where((kind == 2) | (kind == 3), share, 0.0)
    east_m = samples.west_m + samples.pixel_east_m * place[:, 0]
    north_m = samples.south_m + samples.pixel_north_m * place[:, 1]
    target = np.column_stack([east_m, north_m, ground.height_m(east_m, north_m)])
    origin = target + rng.uniform([-300, -300, 800], [300, 300, 1200], (count, 3))
    origin[::5, 0] = target[::5, 0]  # in the vertical plane of an edge
    return Rays(origin, (target - origin) / np.linalg.norm(target - origin, axis=1)[:, None], 1)


_DEGREE = pi / 180

KINDS: dict[str, Callable[[np.random.Generator], Rays]] = {
    "4 axes": lambda rng: beams(rng, 22.5 * _DEGREE, 1000.0, 1, 4),
    f"1 beam of {BEAMLETS}": lambda rng: beams(rng, 22.5 * _DEGREE, 1000.0, BEAMLETS, 1),
    FOUR_BEAMS: lambda rng: beams(rng, 22.5 * _DEGREE, 1000.0, BEAMLETS, 4),
    "the same at 60 degrees": lambda rng: beams(rng, 60 * _DEGREE, 400.0, BEAMLETS, 4),
    "along edges of cells": lambda rng: beams(rng, 22.5 * _DEGREE, 1000.0, BEAMLETS, 4, True),
    "256 unrelated": lambda rng: unrelated(rng, 256),
    "1024 unrelated": lambda rng: unrelated(rng, 1024),
}
"""The timed rays, by the names of the table."""


def shots(kind: str, count: int) -> list[Rays]:
    """Different rays of a kind."""
    rng = np.random.default_rng(2)
    return [KINDS[kind](rng) for _ in range(count)]
