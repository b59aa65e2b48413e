"""Conversion between latitudes and longitudes and the map of a raster file, by PROJ through rasterio."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scene.terrain.model import Ellipsoid
from lidar_emu.scene.terrain.raster import failures

_DEGREES = np.arange(-180.0, 180.0)


@dataclass(frozen=True)
class Projection:
    """The map of a file, on the body that the file states.

    Latitudes here are planetographic; the convention of the file is converted.
    """

    wkt: str
    """Projection as the file states it, WKT."""

    def map_xy(self, latitude_rad: FloatArray, longitude_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Map coordinates of points (n,) in the map's unit; NaN where a point is off the map."""
        latitude = np.asarray(latitude_rad)
        if self._is_planetocentric:
            square = (self.ellipsoid.polar_m / self.ellipsoid.equatorial_m) ** 2
            latitude = np.arctan2(square * np.sin(latitude), np.cos(latitude))
        turns = np.degrees(np.asarray(longitude_rad)) + 180.0
        return _transform(self._body, self._map, turns % 360.0 - 180.0, np.degrees(latitude))

    def geodetic(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Latitude and east longitude of points (n,) on the map; NaN off the body."""
        longitude_deg, latitude_deg = _transform(self._map, self._body, np.asarray(x), np.asarray(y))
        latitude_deg[~(np.abs(latitude_deg) <= 90.0)] = np.nan
        latitude = np.radians(latitude_deg)
        if self._is_planetocentric:
            latitude = self.normal_angle(latitude)
        return latitude, np.radians(longitude_deg)

    def normal_angle(self, planetocentric_rad: FloatArray) -> FloatArray:
        """Planetographic from planetocentric latitude: its tangent is larger by (a/b)²."""
        square = (self.ellipsoid.equatorial_m / self.ellipsoid.polar_m) ** 2
        return np.asarray(np.arctan2(square * np.sin(planetocentric_rad), np.cos(planetocentric_rad)))

    @cached_property
    def ellipsoid(self) -> Ellipsoid:
        """The body."""
        stated = (self._base.get("datum") or self._base["datum_ensemble"])["ellipsoid"]
        equatorial_m = float(stated.get("radius") or stated["semi_major_axis"])
        polar_m = float(stated.get("semi_minor_axis", equatorial_m))
        if stated.get("inverse_flattening"):
            polar_m = equatorial_m * (1 - 1 / float(stated["inverse_flattening"]))
        return Ellipsoid(equatorial_m, polar_m)

    @cached_property
    def turn(self) -> float | None:
        """Length of a full turn of longitude in the map's unit, if meridians are straight and evenly spaced."""
        along, _ = self.map_xy(np.zeros(360), np.radians(_DEGREES))
        higher, _ = self.map_xy(np.full(360, 0.5), np.radians(_DEGREES))
        step = np.diff(along)
        degree = float(np.median(step))
        # The map is cut along one meridian.
        even = np.abs(step - degree) <= 1e-6 * abs(degree)
        if not (
            degree > 0 and even.sum() >= len(step) - 1 and np.allclose(along, higher, rtol=0, atol=degree)
        ):
            return None
        return 360.0 * degree

    @cached_property
    def _map(self) -> Any:
        from rasterio.crs import CRS

        return CRS.from_wkt(self.wkt)

    @cached_property
    def _body(self) -> Any:
        from rasterio.crs import CRS

        axes = f"+a={self.ellipsoid.equatorial_m!r} +b={self.ellipsoid.polar_m!r}"
        return CRS.from_proj4(f"+proj=longlat {axes} +no_defs")

    @cached_property
    def _base(self) -> dict[str, Any]:
        definition = self._map.to_dict(projjson=True)
        # The system is compound where the file also states a vertical system or a datum shift.
        definition = definition.get("source_crs", definition)
        definition = definition.get("components", [definition])[0]
        base: dict[str, Any] = definition.get("base_crs", definition)
        return base

    @cached_property
    def _is_planetocentric(self) -> bool:
        # The IAU's list of coordinate systems calls them "Ocentric".
        return self.ellipsoid.square_eccentricity != 0 and "ocentric" in self._base["name"].lower()


def _transform(source: Any, target: Any, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    from rasterio.warp import transform

    try:
        there = transform(source, target, x, y)
    except failures():
        # A single point without an image makes the whole call fail: halve until it is alone.
        if len(x) == 1:
            return np.array([np.nan]), np.array([np.nan])
        middle = len(x) // 2
        parts = (_transform(source, target, x[k], y[k]) for k in (slice(middle), slice(middle, None)))
        first, second = parts
        return np.concatenate([first[0], second[0]]), np.concatenate([first[1], second[1]])
    there_x, there_y = (np.array(values, dtype=np.float64) for values in there)
    lost = ~(np.isfinite(there_x) & np.isfinite(there_y))
    there_x[lost] = there_y[lost] = np.nan
    return there_x, there_y
