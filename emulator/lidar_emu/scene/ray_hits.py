"""Hits of rays, and the interface of every scene.

The ground is solid and includes its surface. A ray hits the first of its points that lies in the ground, so that a ray
that starts on the surface hits it at range 0, and one that starts below it is inside.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray

NOTHING, GROUND = -1, 0
"""Values of `Hits.object_id` for rays that hit nothing or the ground."""


class Hits(NamedTuple):
    """Hits of n rays."""

    range_m: FloatArray
    """(n,) Distance along the ray; NaN where nothing is hit."""
    normal_site: FloatArray
    """(n, 3) Unit normal in the site frame, pointing out of the ground; NaN where nothing is hit."""
    inside: BoolArray
    """(n,) Whether the ray starts below the surface; its range is NaN."""
    reflectance: FloatArray
    """(n,) Albedo at the hit; NaN where nothing is hit."""
    object_id: NDArray[np.int16]
    """(n,) What is hit: 0 the ground, 1, 2, ... the site's objects in order, -1 nothing."""
    velocity_site_mps: FloatArray
    """(n, 3) Velocity of the surface at the hit, NaN where nothing is hit; empty in a static scene."""

    @classmethod
    def empty(cls, count: int, moving: bool = False) -> Self:
        """Uninitialised hits of ``count`` rays, for a kernel to fill."""
        return cls(
            range_m=np.empty(count),
            normal_site=np.empty((count, 3)),
            inside=np.empty(count, dtype=np.bool_),
            reflectance=np.empty(count),
            object_id=np.empty(count, dtype=np.int16),
            velocity_site_mps=np.empty((count if moving else 0, 3)),
        )

    @classmethod
    def none(cls, count: int, moving: bool = False) -> Self:
        """Hits of ``count`` rays that hit nothing."""
        hits = cls.empty(count, moving)
        for numbers in (hits.range_m, hits.normal_site, hits.reflectance, hits.velocity_site_mps):
            numbers.fill(np.nan)
        hits.inside.fill(False)
        hits.object_id.fill(NOTHING)
        return hits

    @property
    def moving(self) -> bool:
        return self.velocity_site_mps.size > 0

    @property
    def on_static_ground(self) -> tuple[FloatArray, FloatArray, BoolArray, FloatArray, NDArray[np.int16]]:
        """All arrays but the velocities, as kernels take them."""
        return self[:5]

    def set_rows(self, rows: IntArray | slice, found: Hits) -> None:
        """Replace the hits of some rays, with velocities if both have them."""
        ours: tuple[NDArray[Any], ...] = self
        theirs: tuple[NDArray[Any], ...] = found
        for all_rays, some in zip(ours, theirs, strict=True):
            if len(all_rays) and len(some):
                all_rays[rows] = some

    def keep_nearer(self, others: Hits, rows: IntArray | None = None) -> None:
        """Replace hits by hits on other objects that are nearer, or at the same distance.

        A ray that starts inside an object hits nothing else.

        Args:
            others: (m,) other hits of the same rays.
            rows: (m,) indices of these rays among the n; None: all.
        """
        rows = np.arange(len(others.range_m)) if rows is None else rows
        range_m = self.range_m[rows]
        nearer = (others.range_m <= range_m) | (np.isnan(range_m) & np.isfinite(others.range_m))
        nearer = others.inside | (nearer & ~self.inside[rows])
        if nearer.any():
            self.set_rows(rows[nearer], others.chosen(nearer))

    def chosen(self, which: BoolArray | IntArray) -> Self:
        """The hits of some of the rays."""
        arrays: tuple[NDArray[Any], ...] = self
        return type(self)(*(values[which] if len(values) else values for values in arrays))

    def shaped(self, shape: tuple[int, ...]) -> Self:
        """The same hits, reshaped: (n,) becomes ``shape``."""
        moving_shape = shape if self.moving else (0,) * len(shape)
        return type(self)(
            self.range_m.reshape(shape),
            self.normal_site.reshape(*shape, 3),
            self.inside.reshape(shape),
            self.reflectance.reshape(shape),
            self.object_id.reshape(shape),
            self.velocity_site_mps.reshape(*moving_shape, 3),
        )


class Scene(Protocol):
    """The ground in the site frame: east, north, up in metres."""

    description: str
    """One line for plans."""
    origin_altitude_m: float
    """Altitude of the site frame's origin above the body's sphere."""

    def cast(
        self,
        origin_site_m: FloatArray,
        direction_site: FloatArray,
        hits: Hits | None = None,
        bundle: int = 1,
    ) -> Hits:
        """First contact of rays with the ground.

        Args:
            origin_site_m: (n, 3) starting points.
            direction_site: (n, 3) unit vectors; a row with NaN hits nothing.
            hits: filled and returned; None: allocated.
            bundle: number of consecutive rays that are close together, such as the beamlets of a beam; it affects the
                run time only.
        """

    def height_m(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        """Height z (n,) of the ground straight above or below; NaN where there is none."""

    def covers(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        """Whether points are within the scene, (n,); False where a vehicle has left the ground for good."""


@runtime_checkable
class MovingScene(Scene, Protocol):
    """A scene with moving objects; the methods of `Scene` refer to the start of the run."""

    def cast_at(
        self,
        time_ns: IntArray,
        origin_site_m: FloatArray,
        direction_site: FloatArray,
        hits: Hits | None = None,
    ) -> Hits:
        """First contact of rays at their times.

        Args:
            time_ns: (m,) times since the start, each for the next n / m rays.
            origin_site_m, direction_site, hits: see `Scene.cast`.
        """


def contiguous(first: ArrayLike, second: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Both arrays in the layout of the kernels: float64 in C order, so that each kernel is compiled once."""
    return np.ascontiguousarray(first, dtype=np.float64), np.ascontiguousarray(second, dtype=np.float64)


class RayCaster(ABC):
    """A scene that fills the hits of rays whose arrays are contiguous."""

    by_kernels = False
    """Whether `cast` computes in kernels alone, the same ones for all rays unless one of them returns another value."""

    def cast(
        self,
        origin_site_m: FloatArray,
        direction_site: FloatArray,
        hits: Hits | None = None,
        bundle: int = 1,
    ) -> Hits:
        origin, direction = contiguous(origin_site_m, direction_site)
        hits = hits or Hits.empty(len(origin))
        self._fill(origin, direction, hits, bundle)
        return hits

    @abstractmethod
    def _fill(self, origin: FloatArray, direction: FloatArray, hits: Hits, bundle: int) -> None:
        """Set the hits (n,) of rays in the layout of the kernels."""
