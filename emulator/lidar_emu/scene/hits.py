"""What a ray finds, and what every ground can be asked.

The ground is solid: everything at and below its surface. A ray hits the first of its points that lies in the
ground, so one that starts on the surface hits it at range 0, and one that starts below it is inside.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from lidar_emu.arrays import BoolArray, FloatArray


class Hits(NamedTuple):
    """Where n rays meet the ground."""

    range_m: FloatArray
    """(n,) distance along the ray; NaN where nothing is hit."""
    normal_site: FloatArray
    """(n, 3) unit normal in the site frame, pointing out of the ground; NaN where nothing is hit."""
    inside: BoolArray
    """(n,) whether the ray starts below the surface; its range is NaN."""

    @classmethod
    def empty(cls, count: int) -> Hits:
        """Room for ``count`` rays, for a kernel to fill."""
        return cls(np.empty(count), np.empty((count, 3)), np.empty(count, dtype=np.bool_))

    @classmethod
    def none(cls, count: int) -> Hits:
        """``count`` rays that hit nothing."""
        return cls(np.full(count, np.nan), np.full((count, 3), np.nan), np.zeros(count, dtype=np.bool_))


class Scene(Protocol):
    """The ground in the site frame: east, north, up in metres."""

    @property
    def description(self) -> str:
        """One line for plans."""

    @property
    def origin_altitude_m(self) -> float:
        """Height of the site frame's origin above the body's sphere."""

    def cast(self, origin_site_m: FloatArray, direction_site: FloatArray, hits: Hits | None = None) -> Hits:
        """First contact of rays with the ground.

        Args:
            origin_site_m: (n, 3) starting points.
            direction_site: (n, 3) unit vectors; a row with NaN hits nothing.
            hits: to be filled and returned; None: new ones.
        """

    def cast_exact(self, origin_site_m: FloatArray, direction_site: FloatArray) -> Hits:
        """The same as `cast` by a slow and independent path, for checks."""

    def height_m(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        """(n,) site z of the ground straight above or below; NaN where there is none."""

    def covers(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        """(n,) False where a vehicle has left the ground for good."""


def incidence_deg(hits: Hits, direction_site: FloatArray) -> FloatArray:
    """Between rays (..., 3) and the normals that they met; NaN where nothing is hit."""
    along = hits.normal_site * direction_site
    # Axis by axis: a sum over an axis adds in an order of its own.
    return np.degrees(np.arccos(np.clip(-(along[..., 0] + along[..., 1] + along[..., 2]), -1.0, 1.0)))


def contiguous(first: npt.ArrayLike, second: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Both arrays as the kernels take them: float64 in C order, so that each is compiled once."""
    return (
        np.ascontiguousarray(first, dtype=np.float64),
        np.ascontiguousarray(second, dtype=np.float64),
    )
