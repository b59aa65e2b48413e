"""An elevation grid in the site frame, from a file or generated."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vector_arrays import dot

LARGEST_M = 1e8
"""Larger than the radius of any planet, from whose centre the heights of some files count."""
_MARKERS = (-32768.0, -32767.0, -9999.0, -99999.0, 32767.0, 65535.0)
"""Numbers that commonly mark missing samples."""
_APART = 0.01
"""A marker lies further from all heights than this fraction of their range; a height of that value does not."""
_MARKS = "commonly marks missing ones"
_FAR_M = 100.0
"""Any whole number that lies further from all heights than this, and than their range, is asked about."""


class HeightRange(NamedTuple):
    """Range of the heights of a grid; NaN where there are none."""

    lowest_m: float
    highest_m: float
    step_m: float
    """Largest difference of neighbours in a row or a column."""

    def __str__(self) -> str:
        low_m, high_m = (round(height_m, 2) for height_m in (self.lowest_m, self.highest_m))
        return f"heights {low_m:.7g} to {high_m:.7g} m, largest step {self.step_m:.3g} m"


def height_range(elevation_m: FloatArray) -> HeightRange:
    """Measure a grid (rows, columns) in which missing samples are NaN."""
    low, high, step_m = _extremes(np.ascontiguousarray(elevation_m))
    if low < 0:
        return HeightRange(np.nan, np.nan, np.nan)
    return HeightRange(float(elevation_m.flat[low]), float(elevation_m.flat[high]), step_m)


def check_heights(
    where: str, stored: npt.NDArray[np.generic], elevation_m: FloatArray, marker: float | None
) -> None:
    """Refuse numbers that mark missing samples without being stated as such, and heights beyond any body.

    Args:
        where: the file.
        stored: (rows, columns) numbers of the file.
        elevation_m: (rows, columns) the same in metres, NaN where missing.
        marker: the number that the site states for missing samples. One that no sample has says that there are none.
    """
    low, high, _ = _extremes(elevation_m)
    if low < 0:
        return
    span = float(stored.flat[high]) - float(stored.flat[low])
    metres = (elevation_m.flat[high] - elevation_m.flat[low]) / span if span else 1.0
    for place in (low, high):
        number, height_m = float(stored.flat[place]), elevation_m.flat[place]
        why = _suspicion(number, stored[~np.isnan(elevation_m)], metres) if number.is_integer() else ""
        if why and (marker is None or (stored == _as_stored(marker, stored.dtype)).any()):
            found = f"{(stored == number).sum()} samples of {number:g}, which {why}"
            remedy = (
                f"state ground.nodata: {number:g} if they are missing, another number if they are heights"
            )
            raise InputError(where, None, Finding(found), remedy)
        if abs(height_m) > LARGEST_M:
            remedy = (
                f"state ground.nodata: {number!r} if such samples are missing, or a ground.elevation_scale"
            )
            raise InputError(where, None, Finding(f"a height of {height_m:.6g} m"), remedy)


@kernel
def _extremes(elevation_m: FloatArray) -> tuple[int, int, float]:
    """Places of the lowest and of the highest sample in the flattened grid, -1 if all are missing, and the largest
    step; NaN if no neighbours are known."""
    rows, columns = elevation_m.shape
    lowest, highest, step = -1, -1, -1.0
    low, high = np.inf, -np.inf
    for row in range(rows):
        for column in range(columns):
            here = elevation_m[row, column]
            if here < low:
                low, lowest = here, row * columns + column
            if here > high:
                high, highest = here, row * columns + column
            # Comparisons with NaN are false.
            if row and abs(here - elevation_m[row - 1, column]) > step:
                step = abs(here - elevation_m[row - 1, column])
            if column and abs(here - elevation_m[row, column - 1]) > step:
                step = abs(here - elevation_m[row, column - 1])
    return lowest, highest, step if step >= 0.0 else np.nan


def _suspicion(number: float, heights: npt.NDArray[np.generic], metres: float) -> str:
    """Why a whole number, the lowest or highest of a grid, may mark missing samples; empty if it is like others.

    Args:
        number: the number, as stored.
        heights: all numbers of the grid but those of missing samples.
        metres: metres of one.
    """
    others = heights[heights != number]
    is_marker = number in _MARKERS
    if not others.size:
        return _MARKS if is_marker else ""
    low, high = float(others.min()), float(others.max())
    apart = min(abs(number - low), abs(number - high))
    if is_marker and apart > max(_APART * (high - low), 1.0):
        return _MARKS
    is_far = low < high and apart > high - low and _FAR_M < apart * metres < LARGEST_M
    return f"lies {apart:g} beyond all others" if is_far else ""


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
        return np.stack([dot(offset_m, axis) for axis in self._site_from_body_fixed], axis=-1)

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


def _direction(out: FloatArray, up: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sine and cosine of the angle from ``out`` to ``up``."""
    length = np.hypot(out, up)
    return up / length, out / length


MAXIMUM_SAMPLES = 100_000_000


@dataclass(frozen=True)
class Terrain:
    """Elevations at positions east and north of the origin of the site frame."""

    elevation_m: FloatArray
    """(rows, columns) Height above the level plane that lies `origin_elevation_m` below the ground at the origin; rows
    from north to south, columns from west to east; NaN where missing."""
    west_m: float
    """East coordinate of the first column."""
    north_m: float
    """North coordinate of the first row."""
    pixel_east_m: float
    """Distance between columns."""
    pixel_north_m: float
    """Distance between rows."""
    origin_elevation_m: float
    """Elevation of the ground at the origin above the datum of the file."""
    source: str
    """The file."""
    frame: LocalFrame | None = None
    """Frame of the origin on the body; None if the grid is flat, like its map."""
    heights: HeightRange | None = None
    """Heights of the file's own samples, where the grid curves away with the body; None: as in `elevation_m`."""
    placed: str = ""
    """Placement of the samples, for plans; empty if unchanged from the file."""
    reflectance: FloatArray | None = None
    """(rows, columns) Albedo, if the file has it; NaN where missing."""
    rock_abundance: FloatArray | None = None
    """(rows, columns) Fraction of the area covered by rocks, if the file has it; NaN where missing."""

    @property
    def description(self) -> str:
        rows, columns = self.elevation_m.shape
        pixel = f"{self.pixel_east_m:.6g} m"
        if self.pixel_north_m != self.pixel_east_m:
            pixel = f"{self.pixel_east_m:.6g} m x {self.pixel_north_m:.6g} m"
        missing = np.isnan(self.elevation_m).mean()
        holes = f", {missing:.2%} missing" if missing else ""
        details = [
            str(self.heights or height_range(self.elevation_m)),
            self.placed,
            _range("albedo", self.reflectance),
            _range("rock abundance", self.rock_abundance),
        ]
        size = f"{(columns - 1) * self.pixel_east_m:.6g} m x {(rows - 1) * self.pixel_north_m:.6g} m"
        grid = f"grid {Path(self.source).name}, {columns} x {rows} samples at {pixel}, {size}{holes}"
        return ", ".join([grid, *filter(None, details)])


def _range(name: str, values: FloatArray | None) -> str:
    if values is None or np.isnan(values).all():
        return ""
    return f"{name} {np.nanmin(values):.3g} to {np.nanmax(values):.3g} (median {np.nanmedian(values):.3g})"


def check_size(where: str, rows: int, columns: int) -> None:
    """Refuse a grid that is too small for a surface, or too large for memory."""
    size = Finding(f"{columns} x {rows} samples")
    if rows < 2 or columns < 2:
        raise InputError(where, None, size, "use at least 2 x 2")
    if rows * columns > MAXIMUM_SAMPLES:
        remedy = f"at most {MAXIMUM_SAMPLES} fit: state a smaller ground.half_size_m, or cut the file"
        raise InputError(where, None, size, remedy)


def numbers(
    stored: npt.NDArray[np.generic], marker: float | None, missing: BoolArray | None = None
) -> FloatArray:
    """Samples as floating-point numbers, NaN where missing.

    Args:
        stored: the file's numbers.
        marker: number that marks a missing sample, if the site names one.
        missing: samples that the file itself marks as missing.
    """
    values = stored.astype(np.float64)
    absent = ~np.isfinite(values)
    if missing is not None:
        absent |= missing
    if marker is not None:
        absent |= values == _as_stored(marker, stored.dtype)
    values[absent] = np.nan
    return values


def refuse_nothing(where: str, elevation_m: FloatArray) -> None:
    """Refuse a grid without any valid sample."""
    if np.isnan(elevation_m).all():
        raise InputError(where, None, Finding("every sample is missing"), "use a grid with elevations")


def _as_stored(marker: float, dtype: np.dtype[np.generic]) -> float:
    """A marker in the precision of the file: numbers such as -3.4028e38 are rounded when they are stored."""
    if dtype.kind != "f":
        return marker
    with np.errstate(over="ignore"):
        return float(np.array(marker).astype(dtype))
