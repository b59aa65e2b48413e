"""Reading of a site's elevation file, of any format."""

from __future__ import annotations

import re
import struct
import warnings
import zlib
from importlib.util import find_spec
from math import pi, prod
from os import SEEK_END
from pathlib import Path
from tokenize import TokenError
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from lidar_emu.errors import Finding, InputError, RunError
from lidar_emu.files import MOST_BYTES_IN_MEMORY, check_extra, check_file
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.site import ElevationGrid
from lidar_emu.scene.terrain.flat import FlatMap, placed_flat, read_flat_raster, refuse_bands, refuse_pixel
from lidar_emu.scene.terrain.model import LARGEST_M, Terrain, check_heights, check_size, numbers
from lidar_emu.scene.terrain.on_body import read_on_body
from lidar_emu.scene.terrain.raster import failures, open_raster

Content = dict[str, npt.NDArray[np.generic]]

_ARRAYS = "store elevation_m (rows from north to south), pixel_m, and optionally map_x_m and map_y_m"
# Exceptions of numpy, which parses headers as Python, and zipfile for a file that is truncated, altered, encrypted, or
# not an archive.
_DAMAGE = (OSError, ValueError, EOFError, RuntimeError, BadZipFile, zlib.error, SyntaxError, TokenError)


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


_LAS = (".las", ".laz")
_INTACT = "use an intact LAS or LAZ file"
_RECORD_BYTES = 54
"""Size of an empty record with variable length, of which a header states the number."""


def holds_points(ground: ElevationGrid) -> bool:
    """Whether a site's file is a point cloud; GDAL reads a regular grid of points as a grid."""
    suffix = Path(ground.file).suffix.lower()
    return suffix in _LAS or (suffix == ".xyz" and ground.pixel_m is not None)


def read_points(ground: ElevationGrid) -> FlatMap:
    """Grid a point cloud: a sample is the mean height of the points in the square around it, missing without points.

    Samples lie at multiples of `pixel_m`.
    """
    refuse_bands(ground)
    pixel_m = ground.pixel_m
    if pixel_m is None:
        remedy = "state the distance in metres between samples of the grid that the points are made into"
        raise InputError(ground.file, "ground.pixel_m", Finding("missing"), remedy)
    check_file(Path(ground.file), "use a point cloud", MOST_BYTES_IN_MEMORY)
    point = _las(ground.file) if Path(ground.file).suffix.lower() in _LAS else _text(ground.file)
    if not (np.abs(point) <= LARGEST_M).all():
        found = Finding(f"points that are not numbers, or beyond {LARGEST_M:g} m")
        raise InputError(ground.file, None, found, "remove them")
    scale = ground.elevation_scale or 1.0
    # Before the means: one marker among the points of a square would be a height.
    known = numbers(point[None, :, 2], ground.nodata)
    check_heights(ground.file, point[None, :, 2], known * scale + ground.elevation_offset_m, ground.nodata)
    point = _some(ground.file, point[np.isfinite(known[0])])
    place = np.rint(point[:, :2] / pixel_m).astype(np.int64)
    (west, south), (east, north) = place.min(axis=0).tolist(), place.max(axis=0).tolist()
    rows, columns = north - south + 1, east - west + 1
    check_size(ground.file, rows, columns)
    if rows * columns > max(_FULL_ENOUGH, _MOST_PER_POINT * len(point)):
        found = Finding(f"{len(point)} points for {columns} x {rows} samples")
        raise InputError(ground.file, "ground.pixel_m", found, "increase it, or remove stray points")
    height = _means((north - place[:, 1]) * columns + place[:, 0] - west, point[:, 2], rows * columns)
    return FlatMap(
        elevation_m=height.reshape(rows, columns) * scale + ground.elevation_offset_m,
        first_x_m=west * pixel_m,
        first_y_m=north * pixel_m,
        pixel_x_m=pixel_m,
        pixel_y_m=pixel_m,
        source=ground.file,
        made_of=f"gridded from {len(point)} points",
    )


_FULL_ENOUGH, _MOST_PER_POINT = 1_000_000, 1000
"""Samples of any grid of points, and of a larger one for each point: two stray points would take gigabytes."""


def _means(cell: np.ndarray[tuple[int], np.dtype[np.int64]], height: FloatArray, cells: int) -> FloatArray:
    """Mean height (cells,) of the points in each cell; NaN without points."""
    count = np.bincount(cell, minlength=cells)
    total = np.bincount(cell, weights=height, minlength=cells)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _las(path: str) -> FloatArray:
    check_extra(path, "a point cloud", "laspy", "points")
    import laspy

    _check_header(path)
    try:
        file = laspy.read(path)
        point = np.stack([np.asarray(file[axis], dtype=np.float64) for axis in "xyz"], axis=-1)
    except MemoryError:
        raise RunError(f"{path}: not enough memory") from None
    except Exception as error:  # The decompressor's exceptions have no common type.
        raise InputError(path, None, Finding(f"unreadable, {error}"), _INTACT) from None
    if len(point) != file.header.point_count:
        found = f"{len(point)} points of {file.header.point_count}"
        raise InputError(path, None, Finding(found), _INTACT)
    _check_metres(path, [*file.header.vlrs, *(file.header.evlrs or ())])
    return _some(path, point)


_UNIT = re.compile(r'UNIT\s*\[\s*"([^"]*)"\s*,\s*([0-9.eE+-]+)')
_DEGREE = pi / 180
_KEYS_OF_UNITS = 3076, 4099
"""GeoTIFF keys of the horizontal and of the vertical unit."""
_METRE = 9001
_KEY_OF_SYSTEM = 3072


def _check_metres(path: str, records: Any) -> None:
    """Refuse a point cloud whose coordinate system counts in feet."""
    units = list[tuple[str, float]]()
    for record in records:
        if hasattr(record, "string"):  # as text, WKT
            units += [(name, float(number)) for name, number in _UNIT.findall(record.string)]
        for key in getattr(record, "geo_keys", ()):
            if key.id in _KEYS_OF_UNITS and key.value_offset != _METRE:
                units.append((f"unit {key.value_offset} of EPSG", 0.0))
            elif key.id == _KEY_OF_SYSTEM and find_spec("rasterio"):
                units.append(_unit_of_system(key.value_offset))
    for name, metres in units:
        if not any(abs(metres - known) < 1e-9 for known in (1.0, _DEGREE)):
            found = Finding(f"coordinates in {name}")
            raise InputError(path, None, found, "convert them to metres")


def _unit_of_system(code: int) -> tuple[str, float]:
    from rasterio.crs import CRS

    try:
        name, metres = CRS.from_epsg(code).linear_units_factor
    except failures():  # a code of a user's own
        return "metre", 1.0
    return name, metres


def _check_header(path: str) -> None:
    """Refuse a header whose records do not fit into the file: laspy reads on through billions of them."""
    with Path(path).open("rb") as file:
        head = file.read(104)
        size = file.seek(0, SEEK_END)
    if len(head) == 104 and head.startswith(b"LASF"):
        header, points_at, records = struct.unpack_from("<HII", head, 94)
        if header + _RECORD_BYTES * records <= points_at <= size:
            return
    raise InputError(path, None, Finding("no LAS header, or a damaged one"), _INTACT)


def _text(path: str) -> FloatArray:
    """Points (n, 3) of a text file: x, y and z in the first columns, below at most one line of names."""
    with Path(path).open(encoding="latin-1") as lines:
        text = (line.replace(",", " ").replace(";", " ") for line in lines)
        try:
            first = next(text, "")
            numbers = _is_numbers(first)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # About a file without rows.
                rest = np.loadtxt(text, usecols=(0, 1, 2), ndmin=2)
        except ValueError as error:
            found = Finding(f"unreadable, {error}")
            raise InputError(path, None, found, "write x, y and z in the first columns") from None
    return _some(path, np.vstack([first.split()[:3], rest]).astype(np.float64) if numbers else rest)


def _is_numbers(line: str) -> bool:
    try:
        return len([float(word) for word in line.split()[:3]]) == 3
    except ValueError:
        return False


def _some(path: str, point: FloatArray) -> FloatArray:
    if not len(point):
        raise InputError(path, None, Finding("no points"), "use a point cloud")
    return point


def read_terrain(ground: ElevationGrid) -> Terrain:
    """Read the elevation file of a site, around the origin that the site names.

    Args:
        ground: the scenario's keys of the file.

    Raises:
        InputError: the file is missing or unreadable, is not an elevation grid, or does not include the origin.
    """
    _check_is_there(ground)
    if _is_npz(ground):
        return _flat(ground, read_npz(ground))
    if holds_points(ground):
        return _flat(ground, read_points(ground))
    with open_raster(ground.file) as file:
        if _is_on_body(ground, file):
            return read_on_body(ground, file)
        return _flat(ground, read_flat_raster(ground, file))


def _flat(ground: ElevationGrid, flat: FlatMap) -> Terrain:
    if ground.half_size_m is not None:
        remedy = "leave it out: a flat grid is taken whole"
        raise InputError(ground.file, "ground.half_size_m", ground.half_size_m, remedy)
    return placed_flat(flat, ground)


def lies_flat(ground: ElevationGrid) -> bool:
    """Whether the map plane of a site's file is taken as the horizontal plane."""
    _check_is_there(ground)
    if _is_npz(ground) or holds_points(ground):
        return True
    with open_raster(ground.file) as file:
        return not _is_on_body(ground, file)


def _check_is_there(ground: ElevationGrid) -> None:
    kinds = "a GeoTIFF, PDS label, ESRI ASCII grid, point cloud (.las, .laz, .xyz) or .npz"
    check_file(Path(ground.file), f"use {kinds}")


def _is_npz(ground: ElevationGrid) -> bool:
    return ground.file.lower().endswith(".npz")


def _is_on_body(ground: ElevationGrid, file: Any) -> bool:
    """Whether the file's coordinates lie on a body and are used; a map in metres around a test bench has none."""
    return (
        ground.placement == "projected"
        and bool(file.crs)
        and (file.crs.is_projected or file.crs.is_geographic)
    )
