"""An elevation grid on its map, as it comes from a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from lidar_emu.arrays import BoolArray, FloatArray
from lidar_emu.errors import Finding, InputError
from lidar_emu.scenario.site import Grid

MAXIMUM_SAMPLES = 100_000_000


@dataclass(frozen=True)
class Terrain:
    """Elevations on a map in metres, north up."""

    elevation_m: FloatArray
    """(rows, columns) above the datum, rows from north to south; NaN where missing."""
    first_x_m: float
    """Map easting of the first column."""
    first_y_m: float
    """Map northing of the first row."""
    pixel_x_m: float
    """From column to column."""
    pixel_y_m: float
    """From row to row."""
    source: str
    """The file."""
    has_map: bool = True
    """Whether the file says where on a map it lies."""
    projection: str | None = None
    """The map's projection as WKT, where the file states one."""

    @property
    def last_x_m(self) -> float:
        """Map easting of the last column."""
        return float(self.first_x_m + self.pixel_x_m * (self.elevation_m.shape[1] - 1))

    @property
    def last_y_m(self) -> float:
        """Map northing of the last row."""
        return float(self.first_y_m - self.pixel_y_m * (self.elevation_m.shape[0] - 1))

    @property
    def description(self) -> str:
        """One line for plans."""
        rows, columns = self.elevation_m.shape
        pixel = f"{self.pixel_x_m:g} m"
        if self.pixel_y_m != self.pixel_x_m:
            pixel = f"{self.pixel_x_m:g} m x {self.pixel_y_m:g} m"
        missing = np.isnan(self.elevation_m).mean()
        holes = f", {missing:.2%} missing" if missing else ""
        return f"grid {Path(self.source).name}, {columns} x {rows} samples at {pixel}{holes}"


def check_size(where: str, rows: int, columns: int) -> None:
    """Refuse a grid that is too small to be a surface, or too large to be held."""
    size = f"{columns} x {rows} samples"
    if rows < 2 or columns < 2:
        raise InputError(where, None, size, "allowed: at least 2 x 2 samples")
    if rows * columns > MAXIMUM_SAMPLES:
        raise InputError(
            where, None, size, f"allowed: at most {MAXIMUM_SAMPLES} samples; cut out the site's area"
        )


def elevations(
    ground: Grid,
    stored: npt.NDArray[np.generic],
    missing: BoolArray | None = None,
    file_scale: float = 1.0,
    file_offset: float = 0.0,
) -> FloatArray:
    """Samples as elevations in metres above the site's datum, NaN where missing.

    Args:
        ground: what the site says of the file.
        stored: (rows, columns) the file's own numbers.
        missing: (rows, columns) samples that the file itself marks.
        file_scale, file_offset: from stored numbers to the file's unit, where it states them.

    Raises:
        InputError: every sample is missing.
    """
    values = stored.astype(np.float64)
    absent = ~np.isfinite(values)
    if missing is not None:
        absent |= missing
    if ground.nodata is not None:
        absent |= values == _as_stored(ground.nodata, stored.dtype)
    if absent.all():
        raise InputError(ground.file, None, Finding("every sample is missing"), "allowed: an elevation grid")
    values[absent] = np.nan
    return (values * file_scale + file_offset) * ground.elevation_scale + ground.elevation_offset_m


def _as_stored(nodata: float, dtype: np.dtype[np.generic]) -> float:
    """A marker in the precision of the file: -3.4028e38 and its like are rounded when they are stored."""
    if dtype.kind != "f":
        return nodata
    with np.errstate(over="ignore"):
        return float(np.array(nodata).astype(dtype))
