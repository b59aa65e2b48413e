"""Elevation grids in numpy's container: `elevation_m`, `pixel_m`, and the position of the first sample."""

from __future__ import annotations

import zlib
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt
from numpy.lib.npyio import NpzFile

from lidar_emu.errors import Finding, InputError
from lidar_emu.scenario.site import ElevationGrid
from lidar_emu.scene.terrain.flat import FlatMap, refuse_bands, refuse_pixel
from lidar_emu.scene.terrain.heights import check_heights
from lidar_emu.scene.terrain.model import check_size, numbers

Content = dict[str, npt.NDArray[np.generic]]

_ALLOWED = "allowed: elevation_m (rows from north to south), pixel_m, and optionally map_x_m and map_y_m"
# Exceptions of numpy and zipfile for a file that is truncated, altered, encrypted, or not an archive.
_DAMAGE = (OSError, ValueError, EOFError, RuntimeError, BadZipFile, zlib.error)


def read_npz(ground: ElevationGrid) -> FlatMap:
    """Read an `.npz` file as a map.

    Raises:
        InputError: an array is missing, unknown or of another type, numbers cannot be heights, or the file is damaged.
    """
    refuse_bands(ground)
    content = _load(ground.file)
    elevation = content["elevation_m"]
    if elevation.ndim != 2 or elevation.dtype.kind not in "fiu":
        found = f"{elevation.dtype} of shape {elevation.shape}"
        raise InputError(ground.file, "elevation_m", found, "allowed: real numbers, rows by columns")
    check_size(ground.file, *elevation.shape)
    pixel_m = _pixel_m(ground, content)
    if pixel_m <= 0:
        raise InputError(ground.file, "pixel_m", pixel_m, "allowed: a positive length")
    has_map = "map_x_m" in content or "map_y_m" in content
    scale = 1.0 if ground.elevation_scale is None else ground.elevation_scale
    elevation_m = numbers(elevation, ground.nodata) * scale + ground.elevation_offset_m
    check_heights(ground.file, elevation, elevation_m, ground.nodata)
    return FlatMap(
        elevation_m=elevation_m,
        first_x_m=_number(ground.file, content, "map_x_m") if has_map else 0.0,
        first_y_m=_number(ground.file, content, "map_y_m") if has_map else 0.0,
        pixel_x_m=pixel_m,
        pixel_y_m=pixel_m,
        source=ground.file,
        has_map=has_map,
    )


def _load(path: str) -> Content:
    try:
        with Path(path).open("rb") as stream, NpzFile(stream, allow_pickle=False) as file:
            content = {key: np.asarray(file[key]) for key in file.files}
    except _DAMAGE as error:
        allowed = f"{error}; allowed: an intact .npz of plain numbers"
        raise InputError(path, None, Finding("unreadable"), allowed) from None
    for key in content:
        if key not in ("elevation_m", "pixel_m", "map_x_m", "map_y_m"):
            raise InputError(path, key, "an unknown array", _ALLOWED)
    if "elevation_m" not in content:
        raise InputError(path, "elevation_m", Finding("missing"), _ALLOWED)
    return content


def _pixel_m(ground: ElevationGrid, content: Content) -> float:
    """Distance between samples, from the file or else from the site."""
    if "pixel_m" in content:
        refuse_pixel(ground)
        return _number(ground.file, content, "pixel_m")
    if ground.pixel_m is None:
        allowed = (
            "allowed: an array pixel_m in the file; or ground.pixel_m, the distance between samples in metres"
        )
        raise InputError(ground.file, "pixel_m", Finding("missing"), allowed)
    return ground.pixel_m


def _number(path: str, content: Content, key: str) -> float:
    value = content.get(key)
    if value is None:
        raise InputError(path, key, "nothing", "allowed: map_x_m and map_y_m together, or neither")
    if value.size != 1 or value.dtype.kind not in "fiu" or not np.isfinite(value.astype(np.float64)).all():
        raise InputError(path, key, f"{value.dtype} of shape {value.shape}", "allowed: one finite number")
    return float(value.astype(np.float64).item())
