"""Static objects before they become triangles: there may be many copies, few of which are ever hit."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.random_streams import generator
from lidar_emu.numerics.vector_arrays import from_yaw_pitch_roll, rotate
from lidar_emu.scenario.objects import Scatter
from lidar_emu.scene.map_area import Rectangle
from lidar_emu.scene.mesh.model import Triangles
from lidar_emu.scene.ray_reach import Span

_ROUNDING = 1 + 1e-9
"""Margin for rotated corners, which may extend beyond the widest one by rounding."""


class Standing(NamedTuple):
    """n copies of an object; n is 1 without `scatter`."""

    shape: Triangles
    """Triangles about the object's position, in the site's axes."""
    place_m: FloatArray
    """(n, 3) Positions in the site frame."""
    scale: FloatArray
    """(n,) Sizes relative to the shape."""
    turn_rad: FloatArray
    """(n,) Rotations about the vertical."""

    @property
    def triangle_count(self) -> int:
        """Number of triangles of all copies."""
        return len(self.shape.corner_m) * len(self.place_m)

    def near(self, area: Rectangle) -> Self:
        """The copies that may reach into an area."""
        (east_m, north_m, _), away_m = self.place_m.T, self._away_m
        near = (area.west_m - away_m <= east_m) & (east_m <= area.east_m + away_m)
        near &= (area.south_m - away_m <= north_m) & (north_m <= area.north_m + away_m)
        return self._replace(place_m=self.place_m[near], scale=self.scale[near], turn_rad=self.turn_rad[near])

    def triangles(self) -> Triangles:
        """Triangles in the site frame, copy after copy."""
        turn = from_yaw_pitch_roll(self.turn_rad, 0.0, 0.0)[:, None, None]
        corner_m = rotate(turn, self.shape.corner_m[None])
        corner_m *= self.scale[:, None, None, None]
        corner_m += self.place_m[:, None, None]
        alike = self.shape.chosen(np.tile(np.arange(len(self.shape.corner_m)), len(corner_m)))
        return alike._replace(corner_m=corner_m.reshape(-1, 3, 3))

    @property
    def _away_m(self) -> FloatArray:
        """Horizontal reach (n,) of each copy from its position."""
        corner_m = self.shape.corner_m
        return np.asarray(self.scale * (_ROUNDING * np.hypot(corner_m[..., 0], corner_m[..., 1]).max()))

    @property
    def span(self) -> Span:
        """Bounds of all copies, with a margin."""
        (east_m, north_m, up_m), away_m = self.place_m.T, self._away_m
        z_m = self.shape.corner_m[..., 2]
        across = Rectangle(
            float((east_m - away_m).min()),
            float((east_m + away_m).max()),
            float((north_m - away_m).min()),
            float((north_m + away_m).max()),
        )
        floor_m, ceiling_m = (up_m + self.scale * z_m.min()).min(), (up_m + self.scale * z_m.max()).max()
        return Span(across, float(floor_m), float(ceiling_m))


def draw_copies(scatter: Scatter) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Draw the copies: positions (n, 2) east and north of the centre, sizes (n,), and rotations (n,) about the
    vertical."""
    random = generator(scatter.seed, bit_generator=np.random.PCG64).random((scatter.count, 4))
    away_m, towards = scatter.radius_m * np.sqrt(random[:, 0]), 2 * np.pi * random[:, 1]
    place_m = away_m[:, None] * np.stack([np.sin(towards), np.cos(towards)], axis=-1)
    least, greatest = scatter.scale
    return place_m, least * (greatest / least) ** random[:, 2], 2 * np.pi * random[:, 3]
