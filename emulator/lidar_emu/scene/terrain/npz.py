"""Elevation grids in numpy's container: `elevation_m`, `pixel_m`, and the position of the first sample."""

from __future__ import annotations

import zlib
from math import prod
from zipfile import BadZipFile, ZipFile

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from lidar_emu.errors import Finding, InputError
from lidar_emu.scenario.site import ElevationGrid
from lidar_emu.scene.terrain.flat import FlatMap, refuse_bands, refuse_pixel
from lidar_emu.scene.terrain.heights import check_heights
from lidar_emu.scene.terrain.model import check_size, numbers

Content = dict[str, npt.NDArray[np.generic]]

_ARRAYS = "store elevation_m (rows from north to south), pixel_m, and optionally map_x_m and map_y_m"
# Exceptions of numpy and zipfile for a file that is truncated, altered, encrypted, or not an archive.
_DAMAGE = (OSError, ValueError, EOFError, RuntimeError, BadZipFile, zlib.error)


def read_npz(ground: ElevationGrid) -> FlatMap:
    """Read an `.npz` file as a map."""
    refuse_bands(ground)
    content = _load(ground.file)
    elevation = content["elevation_m"]
    pixel_m = _pixel_m(ground, content)
    if pixel_m <= 0:
        raise InputError(ground.file, "pixel_m", pixel_m, "must be positive")
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
        with ZipFile(path) as archive:
            keys = {name.removesuffix(".npy"): name for name in archive.namelist()}
            for key in keys:
                if key not in ("elevation_m", "pixel_m", "map_x_m", "map_y_m"):
                    raise InputError(path, key, Finding("an unknown array"), _ARRAYS)
            if "elevation_m" not in keys:
                raise InputError(path, "elevation_m", Finding("missing"), _ARRAYS)
            return {key: _array(path, key, archive, name) for key, name in keys.items()}
    except _DAMAGE as error:
        found = Finding(f"unreadable, {error}")
        raise InputError(path, None, found, "use an intact .npz of plain numbers") from None


def _array(path: str, key: str, archive: ZipFile, name: str) -> npt.NDArray[np.generic]:
    """An array whose type and shape can be used: megabytes of an archive may hold gigabytes of zeros."""
    with archive.open(name) as entry:
        # Other versions exist for headers of up to 4 GB, which numpy reads whole.
        if npy.read_magic(entry) != (1, 0):
            raise ValueError(f"{key} has a header for structured arrays")
        shape, _, dtype = npy.read_array_header_1_0(entry)
    is_grid = key == "elevation_m"
    if dtype.kind not in "fiu" or (len(shape) != 2 if is_grid else prod(shape) != 1):
        remedy = "store real numbers, rows by columns" if is_grid else "store one finite number"
        raise InputError(path, key, Finding(f"{dtype} of shape {shape}"), remedy)
    if is_grid:
        check_size(path, *shape)
    with archive.open(name) as entry:
        array: npt.NDArray[np.generic] = npy.read_array(entry, allow_pickle=False)
    return array


def _pixel_m(ground: ElevationGrid, content: Content) -> float:
    """Distance between samples, from the file or else from the site."""
    if "pixel_m" in content:
        refuse_pixel(ground)
        return _number(ground.file, content, "pixel_m")
    if ground.pixel_m is None:
        remedy = "store it in the file, or state ground.pixel_m, the distance between samples in metres"
        raise InputError(ground.file, "pixel_m", Finding("missing"), remedy)
    return ground.pixel_m


def _number(path: str, content: Content, key: str) -> float:
    value = content.get(key)
    if value is None:
        raise InputError(path, key, Finding("missing"), "store both map_x_m and map_y_m, or neither")
    number = float(value.astype(np.float64).item())
    if not np.isfinite(number):
        raise InputError(path, key, number, "must be one finite number")
    return number
