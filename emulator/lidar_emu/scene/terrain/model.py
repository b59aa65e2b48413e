"""An elevation grid in the site frame, from a file or generated."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.scene.terrain.frame import LocalFrame
from lidar_emu.scene.terrain.heights import HeightRange, height_range

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
    """Range of a band as text; empty if there is none."""
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
