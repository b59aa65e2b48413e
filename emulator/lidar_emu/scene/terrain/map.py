"""An open raster file as a map of a body: positions of samples, and windows of samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.scenario.site import ElevationGrid
from lidar_emu.scene.terrain.flat import refuse_no_place, refuse_pixel
from lidar_emu.scene.terrain.model import check_size
from lidar_emu.scene.terrain.raster import SAMPLE_IN_PIXEL, Projection


class RasterMap:
    """Samples of a file, indexed by columns and rows from the first one, on the body of its projection.

    Args:
        ground: the scenario's keys of the file.
        file: the open file, which states a projection.
    """

    def __init__(self, ground: ElevationGrid, file: Any) -> None:
        if file.transform.is_identity or not file.transform.determinant:
            refuse_no_place(ground.file)
        refuse_pixel(ground)
        self.source = ground.file
        self.projection = Projection(file.crs.to_wkt())
        self.columns: int = file.width
        self.rows: int = file.height
        self._map_of_pixel = file.transform

    def sample_at(
        self, latitude_rad: FloatArray, longitude_rad: FloatArray, near_column: float
    ) -> tuple[FloatArray, FloatArray]:
        """Fractional columns and rows (n,) of positions on the body; NaN off the map.

        On a cylindrical map, columns a full turn apart are equivalent: the one nearest to ``near_column`` is returned.
        """
        column, row = _mapped(~self._map_of_pixel, *self.projection.map_xy(latitude_rad, longitude_rad))
        column, row = column - SAMPLE_IN_PIXEL, row - SAMPLE_IN_PIXEL
        if self.turn:
            column = column - self.turn * np.round((column - near_column) / self.turn)
        return column, row

    def geodetic(self, column: FloatArray, row: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Planetographic latitude and east longitude of fractional columns and rows (n,); NaN off the body."""
        return self.projection.geodetic(
            *_mapped(self._map_of_pixel, column + SAMPLE_IN_PIXEL, row + SAMPLE_IN_PIXEL)
        )

    @cached_property
    def turn(self) -> float | None:
        """Columns in a full turn of longitude, if the map is cylindrical."""
        width = self.projection.turn
        if width is None or self._map_of_pixel.b or self._map_of_pixel.d:
            return None
        columns = float(abs(width / self._map_of_pixel.a))
        # Files round their scales: a map of a full turn has a whole number of columns.
        return (
            float(round(columns))
            if abs(columns - round(columns)) < 0.5 and self._closes(columns)
            else columns
        )

    @cached_property
    def is_closed(self) -> bool:
        """Whether the last column of the map is followed by the first."""
        return self.turn is not None and self._closes(self.turn)

    def _closes(self, turn: float) -> bool:
        return self.columns > turn - 0.5

    @cached_property
    def pole_rows(self) -> tuple[bool, bool]:
        """Whether a pole lies half a row beyond the first row, and beyond the last one, of a closed map."""
        if not self.is_closed:
            return False, False
        _, row = self.sample_at(np.radians([90.0, -90.0]), np.zeros(2), 0.0)
        beyond = np.stack([-row, row - (self.rows - 1)])
        near: BoolArray = (beyond > 0.25) & (beyond < 0.75)
        return bool(near[0].any()), bool(near[1].any())


def _mapped(affine: Any, first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    return (
        affine.a * first + affine.b * second + affine.c,
        affine.d * first + affine.e * second + affine.f,
    )


@dataclass(frozen=True)
class MapWindow:
    """A rectangle of samples; rows and columns may lie beyond the file where the map continues."""

    first_column: int
    end_column: int
    first_row: int
    end_row: int


Read = Callable[[Any], FloatArray]
"""Reads the samples of a `rasterio.windows.Window`."""


@dataclass(frozen=True)
class MapSamples:
    """A window of samples as a bilinear surface."""

    values: FloatArray
    """(rows, columns)"""
    first_column: int
    first_row: int

    def at(self, column: FloatArray, row: FloatArray) -> FloatArray:
        """Heights (n,) of the surface at columns and rows of the file; NaN outside the window and beside missing
        samples.

        The outermost cells extend by half a cell, to the edges of the outermost pixels.
        """
        rows, columns = self.values.shape
        across, down = column - self.first_column, row - self.first_row
        outside = ~((across >= -0.5) & (across <= columns - 0.5) & (down >= -0.5) & (down <= rows - 0.5))
        left = np.clip(np.where(outside, 0.0, across), 0.0, columns - 2.0).astype(np.int64)
        top = np.clip(np.where(outside, 0.0, down), 0.0, rows - 2.0).astype(np.int64)
        a, b = across - left, down - top
        upper = self._between(top, left, a)
        lower = self._between(top + 1, left, a)
        return np.where(outside, np.nan, upper * (1 - b) + lower * b)

    def _between(self, row: IntArray, left: IntArray, share: FloatArray) -> FloatArray:
        return np.asarray(self.values[row, left] * (1 - share) + self.values[row, left + 1] * share)


def window_of(
    raster: RasterMap, column: FloatArray, row: FloatArray, near_column: float, around_pole: bool
) -> MapWindow:
    """Window with all samples around positions (n,), some of which may be off the map (NaN).

    Args:
        raster: the map.
        column, row, near_column: positions, see `RasterMap.sample_at`.
        around_pole: whether every meridian of a closed map is among them.
    """
    margin = 2
    columns = np.nanmin(column) - margin, np.nanmax(column) + margin + 1
    rows = np.nanmin(row) - margin, np.nanmax(row) + margin + 1
    north, south = raster.pole_rows
    first_row = max(int(np.floor(rows[0])), -1 if north else 0)
    end_row = min(int(np.ceil(rows[1])), raster.rows + (1 if south else 0))
    if raster.is_closed and (around_pole or first_row < 0 or end_row > raster.rows):
        assert raster.turn is not None
        middle, half = round(near_column), int(raster.turn) // 2 + margin
        window = MapWindow(middle - half, middle + half + 1, first_row, end_row)
    elif raster.is_closed:
        window = MapWindow(int(np.floor(columns[0])), int(np.ceil(columns[1])), first_row, end_row)
    else:
        first, end = max(int(np.floor(columns[0])), 0), min(int(np.ceil(columns[1])), raster.columns)
        window = MapWindow(first, end, first_row, end_row)
    check_size(raster.source, window.end_row - window.first_row, window.end_column - window.first_column)
    return window


def read_window(raster: RasterMap, window: MapWindow, read: Read) -> MapSamples:
    """Read the samples of a window, continued around the body where it leaves a closed map.

    Beyond the row next to a pole the map continues with the same row, half a turn away.
    """
    first, end = max(window.first_row, 0), min(window.end_row, raster.rows)
    values = _around(raster, window, first, end, read)
    pieces = [values]
    if window.first_row < 0:
        pieces.insert(0, _beyond_pole(raster, window, 0, read))
    if window.end_row > raster.rows:
        pieces.append(_beyond_pole(raster, window, raster.rows - 1, read))
    return MapSamples(np.concatenate(pieces), window.first_column, window.first_row)


def _beyond_pole(raster: RasterMap, window: MapWindow, row: int, read: Read) -> FloatArray:
    assert raster.turn is not None
    half = round(raster.turn / 2)
    opposite = MapWindow(window.first_column + half, window.end_column + half, row, row + 1)
    return _around(raster, opposite, row, row + 1, read)


def _around(raster: RasterMap, window: MapWindow, first_row: int, end_row: int, read: Read) -> FloatArray:
    from rasterio.windows import Window as Cut

    pieces, column = [], window.first_column
    while column < window.end_column:
        start = column % round(raster.turn) if raster.is_closed and raster.turn else column
        width = min(window.end_column - column, raster.columns - start)
        if raster.is_closed and raster.turn:
            width = min(width, round(raster.turn) - start)
        pieces.append(read(Cut(start, first_row, width, end_row - first_row)))
        column += width
    return np.concatenate(pieces, axis=1)
