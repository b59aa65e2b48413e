"""Queries of the ground of a scenario: heights and rays."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.scenario.load import load
from lidar_emu.scenario.required import require_flight
from lidar_emu.scenario.schema import Scenario
from lidar_emu.scene.build import build_scene
from lidar_emu.scene.ray_hits import MovingScene


class RayHits(NamedTuple):
    """First hits of rays, in the shape (...) of the rays; NaN where a ray hits nothing."""

    range_m: FloatArray
    """(...) Distance along the ray."""
    point_site_m: FloatArray
    """(..., 3) Hit point: east, north, up."""
    normal_site: FloatArray
    """(..., 3) Unit normal, pointing out of the ground."""
    incidence_deg: FloatArray
    """(...) Angle between the ray and the ground's normal."""
    reflectance: FloatArray
    """(...) Albedo."""
    object: NDArray[np.int16]
    """(...) What is hit: 0 the ground, 1, 2, ... the site's objects in order, -1 nothing."""
    inside: BoolArray
    """(...) Whether the ray starts below the surface; it then hits nothing."""


class Ground:
    """The ground of a scenario's site with its objects, in the site frame: east, north, up in metres.

    Args:
        scenario: see `load`.
        overrides: see `load`.
        keys: see `load`.

    Raises:
        InputError: the scenario or a file of its site cannot be used, or it is a bench pattern.
    """

    def __init__(
        self,
        scenario: str | PathLike[str] | Mapping[str, Any] | Scenario,
        overrides: Mapping[str, Any] | None = None,
        **keys: Any,
    ) -> None:
        self.site = require_flight(load(scenario, overrides, **keys)).site
        """The site."""
        self._scene = build_scene(self.site)

    @property
    def description(self) -> str:
        """One line on the ground."""
        return self._scene.description

    @property
    def origin_altitude_m(self) -> float:
        """Altitude of the site frame's origin above the body's sphere."""
        return self._scene.origin_altitude_m

    def height_m(self, east_m: ArrayLike, north_m: ArrayLike) -> FloatArray:
        """Height of the ground straight above or below points, without objects; NaN where there is none.

        Args:
            east_m: coordinates of the points.
            north_m: coordinates of the points, broadcast against `east_m`.

        Raises:
            InputError: the arguments are not numbers of compatible shapes.
        """
        east, north = _broadcast("height_m", east_m=east_m, north_m=north_m)
        heights = self._scene.height_m(
            np.ascontiguousarray(east).ravel(), np.ascontiguousarray(north).ravel()
        )
        return heights.reshape(east.shape)

    def cast(self, origin_site_m: ArrayLike, direction_site: ArrayLike, time_s: float = 0.0) -> RayHits:
        """First hits of rays with the ground and its objects.

        Args:
            origin_site_m: (..., 3) starting points.
            direction_site: (..., 3) directions of any length; both are broadcast against each other.
            time_s: scenario time, which matters where objects move.

        Raises:
            InputError: the arguments are not numbers of compatible shapes (..., 3).
        """
        origin, direction = _broadcast("cast", origin_site_m=origin_site_m, direction_site=direction_site)
        if origin.ndim == 0 or origin.shape[-1] != 3:
            raise InputError("cast", None, Finding(f"shape {origin.shape}"), "must be (..., 3)")
        shape = origin.shape[:-1]
        starts = np.ascontiguousarray(origin, dtype=np.float64).reshape(-1, 3)
        rays = direction.reshape(-1, 3)
        with np.errstate(invalid="ignore"):
            rays = np.ascontiguousarray(rays / np.sqrt((rays**2).sum(axis=-1, keepdims=True)))
        if isinstance(self._scene, MovingScene):
            hits = self._scene.cast_at(np.array([round(time_s * 1e9)]), starts, rays)
        else:
            hits = self._scene.cast(starts, rays)
        cosine = np.clip(-(hits.normal_site * rays).sum(axis=-1), -1.0, 1.0)
        return RayHits(
            hits.range_m.reshape(shape),
            (starts + hits.range_m[:, None] * rays).reshape(*shape, 3),
            hits.normal_site.reshape(*shape, 3),
            np.degrees(np.arccos(cosine)).reshape(shape),
            hits.reflectance.reshape(shape),
            hits.object_id.reshape(shape),
            hits.inside.reshape(shape),
        )


def _broadcast(where: str, **arguments: ArrayLike) -> tuple[FloatArray, FloatArray]:
    arrays = []
    for key, value in arguments.items():
        try:
            arrays.append(np.asarray(value, dtype=np.float64))
        except (TypeError, ValueError):
            raise InputError(where, key, value, "must be numbers") from None
    try:
        first, second = np.broadcast_arrays(*arrays)
    except ValueError:
        found = Finding(" and ".join(f"shape {array.shape}" for array in arrays))
        raise InputError(where, None, found, "must be compatible shapes") from None
    return first, second
