"""East, north and up at a point of a body of revolution, and conversion to positions on the body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lidar_emu.numerics.arrays import FloatArray


@dataclass(frozen=True)
class Ellipsoid:
    """A body's reference surface: an ellipsoid of revolution, or a sphere."""

    equatorial_m: float
    polar_m: float

    @property
    def square_eccentricity(self) -> float:
        """1 - (b/a)²; 0 for a sphere."""
        return 1.0 - (self.polar_m / self.equatorial_m) ** 2


@dataclass(frozen=True)
class LocalFrame:
    """The site frame on the body: its origin, with up along the normal of the reference surface.

    North points to the pole; at a pole it points along the meridian opposite to the given longitude.
    """

    ellipsoid: Ellipsoid
    latitude_rad: float
    """Planetographic latitude, the angle of the normal; on a sphere the planetocentric latitude as well."""
    longitude_rad: float
    """East longitude."""
    altitude_m: float
    """Altitude of the origin above the reference surface."""

    def place_m(
        self, latitude_rad: FloatArray, longitude_rad: FloatArray, altitude_m: FloatArray
    ) -> FloatArray:
        """East, north and up (n, 3) of points (n,)."""
        body_m = _body_fixed_m(self.ellipsoid, latitude_rad, longitude_rad, altitude_m)
        offset_m = body_m - self._origin_m
        return np.stack([_along(offset_m, axis) for axis in self._site_from_body_fixed], axis=-1)

    def geodetic(
        self, east_m: FloatArray, north_m: FloatArray, up_m: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Planetographic latitude, east longitude and altitude of points (n,) of the site frame.

        Bowring's formula, applied twice: better than 1e-9 m within the relief of a planet. On a sphere the first
        application is exact.
        """
        east, north, up = self._site_from_body_fixed
        x, y, z = (self._origin_m[k] + east_m * east[k] + north_m * north[k] + up_m * up[k] for k in range(3))
        a, b, e2 = self.ellipsoid.equatorial_m, self.ellipsoid.polar_m, self.ellipsoid.square_eccentricity
        from_axis = np.hypot(x, y)
        # Sines and cosines from lengths are faster than from angles.
        sine, cosine = _direction(from_axis * b, z * a)
        for _ in range(2 if e2 else 1):
            up_part, out_part = z + e2 * a**2 / b * sine**3, from_axis - e2 * a * cosine**3
            sine, cosine = _direction(out_part * a, up_part * b)
        sine, cosine = _direction(out_part, up_part)
        altitude = from_axis * cosine + z * sine - a * np.sqrt(1.0 - e2 * sine**2)
        return np.arctan2(up_part, out_part), np.arctan2(y, x), altitude

    @property
    def _origin_m(self) -> FloatArray:
        at = (np.array(v) for v in (self.latitude_rad, self.longitude_rad, self.altitude_m))
        return _body_fixed_m(self.ellipsoid, *at)

    @property
    def _site_from_body_fixed(self) -> FloatArray:
        return site_from_body_fixed(self.latitude_rad, self.longitude_rad)


def site_from_body_fixed(latitude_rad: float, longitude_rad: float) -> FloatArray:
    """Rotation (3, 3) from body-fixed axes (x toward longitude 0, z toward the north pole) to east, north and up, as
    rows."""
    sine, cosine = np.sin(latitude_rad), np.cos(latitude_rad)
    sine_lon, cosine_lon = np.sin(longitude_rad), np.cos(longitude_rad)
    return np.array(
        [
            [-sine_lon, cosine_lon, 0.0],
            [-sine * cosine_lon, -sine * sine_lon, cosine],
            [cosine * cosine_lon, cosine * sine_lon, sine],
        ]
    )


def _body_fixed_m(
    ellipsoid: Ellipsoid, latitude_rad: FloatArray, longitude_rad: FloatArray, altitude_m: FloatArray
) -> FloatArray:
    sine, cosine = np.sin(latitude_rad), np.cos(latitude_rad)
    e2 = ellipsoid.square_eccentricity
    to_axis_m = ellipsoid.equatorial_m / np.sqrt(1.0 - e2 * sine**2)
    out_m = (to_axis_m + altitude_m) * cosine
    up_m = (to_axis_m * (1.0 - e2) + altitude_m) * sine
    return np.stack([out_m * np.cos(longitude_rad), out_m * np.sin(longitude_rad), up_m], axis=-1)


def _along(vector: FloatArray, axis: FloatArray) -> FloatArray:
    return np.asarray(vector[..., 0] * axis[0] + vector[..., 1] * axis[1] + vector[..., 2] * axis[2])


def _direction(out: FloatArray, up: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sine and cosine of the angle from ``out`` to ``up``."""
    length = np.hypot(out, up)
    return up / length, out / length
