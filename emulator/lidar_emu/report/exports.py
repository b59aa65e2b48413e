"""Export of a measurement for other tools: tables, arrays and point clouds."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from lidar_emu.errors import Finding, InputError
from lidar_emu.files import check_destination, check_extra, check_suffix, whole_file
from lidar_emu.measurement import TABLE, Measurement
from lidar_emu.numerics.arrays import FloatArray

if TYPE_CHECKING:
    import pyarrow as pa

_PLY_FIELDS = {
    "<f8": ("x", "y", "z"),
    "<f4": ("range_m", "closing_speed_mps"),
    "u1": ("beam", "red", "green", "blue"),
}
_PLY_VERTEX = np.dtype([(name, kind) for kind, names in _PLY_FIELDS.items() for name in names])
_GROUP_ROWS = 1 << 16
_PLY_TYPES = {"f8": "double", "f4": "float", "u1": "uchar"}
_DARK_TO_BRIGHT_HEX = "440154 472d7b 3b528b 2c728e 21918c 28ae80 5ec962 addc30 fde725"
_DARK_TO_BRIGHT_RGB = np.array([list(bytes.fromhex(rgb)) for rgb in _DARK_TO_BRIGHT_HEX.split()], dtype=float)
"""Evenly spaced stops of matplotlib's viridis, which needs no matplotlib here."""


def check_export_path(path: Path) -> None:
    """Check the path of an export before a long run.

    Raises:
        InputError: the suffix is unknown, the folder is missing or read-only, or `.parquet` lacks the extra `tables`.
    """
    check_suffix(path, _WRITERS)
    if path.suffix == ".parquet":
        check_extra(str(path), path.suffix, "pyarrow", "tables")
    check_destination(path)


def export(blocks: Iterable[Measurement], path: Path) -> None:
    """Write shots, block by block in order, in the format that the suffix of `path` names.

    `.csv`, `.npz` and `.parquet` hold the columns of `Measurement.table()`, one row per shot and beam. Missing
    values are empty cells in CSV, NaN in NPZ and nulls in Parquet. CSV has booleans as 1 and 0, and floats with all
    their digits. `.ply` holds the points with a valid range (binary, site frame: east, north, up in metres). CSV and
    Parquet are written as the blocks come; the other formats need all of them in memory.

    Raises:
        InputError: see `check_export_path`; or the suffix is `.ply` and the run is a bench pattern.
        RunError: writing failed.
    """
    check_export_path(path)
    if path.suffix == ".ply":
        whole = _whole(blocks)
        if np.isnan(whole.position_site_m).all():
            found = Finding("a bench pattern")
            raise InputError(str(path), None, found, "must be a flight: a bench pattern has no points")
        blocks = [whole]
    with whole_file(path) as file:
        _WRITERS[path.suffix](blocks, file)


def _write_csv(blocks: Iterable[Measurement], file: BinaryIO) -> None:
    text = io.TextIOWrapper(file, encoding="ascii", newline="")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(TABLE)
    for block in blocks:
        rows.writerows(zip(*map(_cells, block.table().values()), strict=True))
    # Otherwise the wrapper would close the caller's file.
    text.detach()


def _cells(column: NDArray[np.generic]) -> list[object]:
    """Convert a column to Python values; the csv module writes floats by `repr` and None as an empty cell."""
    if column.dtype == np.bool_:
        return list(column.astype(np.uint8).tolist())
    if not np.issubdtype(column.dtype, np.floating):
        return list(column.tolist())
    return [None if value != value else value for value in column.tolist()]


def _write_npz(blocks: Iterable[Measurement], file: BinaryIO) -> None:
    columns: dict[str, Any] = {**_whole(blocks).table()}
    np.savez_compressed(file, **columns)


TableColumn = NDArray[Any] | list[str | None]


def arrow_table(columns: Mapping[str, TableColumn], whole: Collection[str] = ()) -> pa.Table:
    """A table for Parquet, with null for NaN, so that queries skip missing values; the columns `whole` as integers.

    Made of the bytes of its columns: `pa.array` imports pandas, which takes as long as ten flights.
    """
    import pyarrow as pa

    return pa.table({name: _arrow_array(column, name in whole) for name, column in columns.items()})


def _arrow_array(column: TableColumn, whole: bool) -> pa.Array:
    import pyarrow as pa

    if isinstance(column, list):
        known = np.array([text is not None for text in column])
        texts = [(text or "").encode() for text in column]
        kind, content = pa.string(), [np.cumsum([0, *map(len, texts)], dtype=np.int32), b"".join(texts)]
    else:
        known = np.equal(column, column)
        values = np.where(known, column, 0).astype(np.int64) if whole else column
        kind = pa.from_numpy_dtype(values.dtype)
        content = [
            np.packbits(values, bitorder="little") if values.dtype == bool else np.ascontiguousarray(values)
        ]
    valid = None if known.all() else pa.py_buffer(np.packbits(known, bitorder="little"))
    return pa.Array.from_buffers(kind, len(column), [valid, *map(pa.py_buffer, content)])


def _write_parquet(blocks: Iterable[Measurement], file: BinaryIO) -> None:
    import pyarrow.parquet

    writer = None
    for part in _larger(blocks):
        table = arrow_table(part.table())
        writer = writer or pyarrow.parquet.ParquetWriter(file, table.schema, write_page_checksum=True)
        writer.write_table(table)
    if writer is not None:
        writer.close()


def _larger(blocks: Iterable[Measurement]) -> Iterator[Measurement]:
    """Join blocks to groups of rows: readers of Parquet load some columns of a whole group."""
    group: list[Measurement] = []
    for block in blocks:
        group.append(block)
        if sum(each.fired.size for each in group) >= _GROUP_ROWS:
            yield _whole(group)
            group.clear()
    if group:
        yield _whole(group)


def _whole(blocks: Iterable[Measurement]) -> Measurement:
    return Measurement.concatenate(list(blocks))


def _write_ply(blocks: Iterable[Measurement], file: BinaryIO) -> None:
    measurement = _whole(blocks)
    vertices = _vertices(measurement)
    properties = (
        f"property {_PLY_TYPES[_PLY_VERTEX[name].str[1:]]} {name}" for name in _PLY_VERTEX.names or ()
    )
    header = (
        "ply",
        "format binary_little_endian 1.0",
        "comment site frame: x east, y north, z up, in metres",
        f"element vertex {len(vertices)}",
        *properties,
        "end_header\n",
    )
    file.write("\n".join(header).encode())
    file.write(vertices.tobytes())


def _vertices(measurement: Measurement) -> NDArray[np.void]:
    valid = measurement.range_valid
    vertices = np.empty(np.count_nonzero(valid), dtype=_PLY_VERTEX)
    vertices["x"], vertices["y"], vertices["z"] = measurement.point_site_m[valid].T
    vertices["range_m"] = measurement.range_m[valid]
    vertices["closing_speed_mps"] = measurement.closing_speed_mps[valid]
    vertices["beam"] = np.nonzero(valid)[1]
    vertices["red"], vertices["green"], vertices["blue"] = _dark_to_bright_rgb(measurement.range_m[valid]).T
    return vertices


def _dark_to_bright_rgb(values: FloatArray) -> NDArray[np.uint8]:
    """(points, 3) Red, green and blue of (points,) values, from dark at the least to bright at the greatest."""
    if values.size == 0:
        return np.empty((0, 3), dtype=np.uint8)
    share = (values - values.min()) / max(np.ptp(values), np.finfo(float).tiny)
    stops = np.linspace(0, 1, len(_DARK_TO_BRIGHT_RGB))
    channels = [np.interp(share, stops, channel) for channel in _DARK_TO_BRIGHT_RGB.T]
    return np.stack(channels, axis=1).round().astype(np.uint8)


_WRITERS: dict[str, Callable[[Iterable[Measurement], BinaryIO], None]] = {
    ".csv": _write_csv,
    ".npz": _write_npz,
    ".parquet": _write_parquet,
    ".ply": _write_ply,
}
SUFFIXES = tuple(_WRITERS)
"""Suffixes of the files that `export` writes."""
