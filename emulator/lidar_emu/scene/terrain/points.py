"""Point clouds as elevation grids: LAS, LAZ and text with x, y and z."""

from __future__ import annotations

import struct
import warnings
from os import SEEK_END
from pathlib import Path

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.files import MOST_BYTES_IN_MEMORY, check_extra, check_file
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.site import ElevationGrid
from lidar_emu.scene.terrain.flat import FlatMap, refuse_bands
from lidar_emu.scene.terrain.heights import LARGEST_M, check_heights
from lidar_emu.scene.terrain.model import check_size

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
    place = np.rint(point[:, :2] / pixel_m).astype(np.int64)
    (west, south), (east, north) = place.min(axis=0).tolist(), place.max(axis=0).tolist()
    rows, columns = north - south + 1, east - west + 1
    check_size(ground.file, rows, columns)
    height = _means((north - place[:, 1]) * columns + place[:, 0] - west, point[:, 2], rows * columns)
    elevation_m = height.reshape(rows, columns) * (ground.elevation_scale or 1.0) + ground.elevation_offset_m
    check_heights(ground.file, height, elevation_m, ground.nodata)
    return FlatMap(
        elevation_m=elevation_m,
        first_x_m=west * pixel_m,
        first_y_m=north * pixel_m,
        pixel_x_m=pixel_m,
        pixel_y_m=pixel_m,
        source=ground.file,
        made_of=f"gridded from {len(point)} points",
    )


def _means(cell: np.ndarray[tuple[int], np.dtype[np.int64]], height: FloatArray, cells: int) -> FloatArray:
    """Mean height (cells,) of the points in each cell; NaN without points."""
    count = np.bincount(cell, minlength=cells)
    total = np.bincount(cell, weights=height, minlength=cells)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _las(path: str) -> FloatArray:
    """Points (n, 3) of a LAS or LAZ file."""
    check_extra(path, "a point cloud", "laspy", "points")
    import laspy

    _check_header(path)
    try:
        file = laspy.read(path)
        point = np.stack([np.asarray(file[axis], dtype=np.float64) for axis in "xyz"], axis=-1)
    except MemoryError:
        raise
    except Exception as error:  # The decompressor's exceptions have no common type.
        raise InputError(path, None, Finding(f"unreadable, {error}"), _INTACT) from None
    if len(point) != file.header.point_count:
        found = f"{len(point)} points of {file.header.point_count}"
        raise InputError(path, None, Finding(found), _INTACT)
    return _some(path, point)


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
