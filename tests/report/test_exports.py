"""Exported files, read back by other readers."""

import csv
import struct
import weakref
from dataclasses import replace

import numpy as np
import pyarrow.parquet
import pytest

from lidar_emu import files
from lidar_emu.errors import InputError, RunError
from lidar_emu.report import exports
from lidar_emu.report.exports import check_export_path, export

PLY_CODES = {"double": "d", "float": "f", "uchar": "B"}


def read_ply(path):
    """Vertices as a list of dicts; knows the format from its definition, and nothing of the writer."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    lines = header.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    words = [line.split() for line in lines]
    (count,) = (int(line[2]) for line in words if line[:2] == ["element", "vertex"])
    properties = [(line[2], PLY_CODES[line[1]]) for line in words if line[0] == "property"]
    row = struct.Struct("<" + "".join(code for _, code in properties))
    assert len(body) == count * row.size
    return [dict(zip([n for n, _ in properties], values, strict=True)) for values in row.iter_unpack(body)]


def test_csv_has_every_bit_and_empty_cells(flight, tmp_path):
    export([flight], tmp_path / "run.csv")
    with (tmp_path / "run.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    table = flight.table()
    assert header == list(table)
    for name, cells in zip(header, zip(*rows, strict=True), strict=True):
        column = table[name]
        assert "nan" not in cells
        if column.dtype.kind == "f":
            read = np.array([float(cell) if cell else np.nan for cell in cells])
        else:
            read = np.array([int(cell) for cell in cells])
        np.testing.assert_array_equal(read, column)
    assert ",," in (tmp_path / "run.csv").read_text()


def test_npz_holds_the_table(flight, tmp_path):
    export([flight], tmp_path / "run.npz")
    table = flight.table()
    with np.load(tmp_path / "run.npz", allow_pickle=False) as file:
        assert list(file) == list(table)
        for name, column in table.items():
            assert file[name].dtype == column.dtype
            np.testing.assert_array_equal(file[name], column)


@pytest.mark.slow
def test_parquet_holds_the_table_with_nulls(flight, tmp_path):
    export([flight], tmp_path / "run.parquet")
    read = pyarrow.parquet.read_table(tmp_path / "run.parquet")
    table = flight.table()
    assert read.column_names == list(table)
    for name, column in table.items():
        missing = np.isnan(column) if column.dtype.kind == "f" else np.zeros(len(column), dtype=bool)
        assert read[name].null_count == missing.sum()
        np.testing.assert_array_equal(read[name].to_numpy(), column)


def test_columns_are_those_that_pyarrow_makes(flight):
    columns = {**flight.table(), "strided": np.arange(flight.fired.size * 2.0)[::2]}
    columns["text"] = [None if k % 3 else f"é{k}" for k in range(flight.fired.size)]
    expected = {name: pyarrow.array(column, from_pandas=True) for name, column in columns.items()}
    assert exports.arrow_table(columns).equals(pyarrow.table(expected))
    whole = exports.arrow_table({"count": np.array([3.0, np.nan])}, whole=["count"])
    assert whole.equals(pyarrow.table({"count": pyarrow.array([3, None], pyarrow.int64())}))


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_tables_are_written_as_the_blocks_come(flight, tmp_path, suffix, monkeypatch):
    monkeypatch.setattr(exports, "_GROUP_ROWS", 24)
    alive = []

    def blocks():
        for first in range(0, len(flight), 2):
            assert sum(block() is not None for block in alive) <= 5
            block = flight.part(first, first + 2)
            alive.append(weakref.ref(block))
            yield block

    export(blocks(), tmp_path / f"parts{suffix}")
    export([flight], tmp_path / f"whole{suffix}")
    assert len(alive) > 10
    if suffix == ".csv":
        assert (tmp_path / "parts.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()
    else:
        assert pyarrow.parquet.ParquetFile(tmp_path / "parts.parquet").num_row_groups > 3
        parts, whole = (
            pyarrow.parquet.read_table(tmp_path / f"{name}.parquet") for name in ("parts", "whole")
        )
        assert parts.equals(whole)


def test_ply_holds_the_valid_points(flight, tmp_path):
    export([flight], tmp_path / "run.ply")
    vertices = read_ply(tmp_path / "run.ply")
    expected = [(k, b) for k in range(len(flight)) for b in range(4) if flight.range_valid[k, b]]
    assert len(vertices) == len(expected) < flight.range_valid.size
    for vertex, (shot, beam) in zip(vertices, expected, strict=True):
        assert vertex["beam"] == beam
        assert [vertex[axis] for axis in "xyz"] == flight.point_site_m[shot, beam].tolist()
        assert vertex["range_m"] == np.float32(flight.range_m[shot, beam])
        np.testing.assert_equal(
            vertex["closing_speed_mps"], float(np.float32(flight.closing_speed_mps[shot, beam]))
        )


def test_ply_colours_are_those_of_viridis(flight, tmp_path):
    from matplotlib import colormaps

    export([flight], tmp_path / "run.ply")
    vertices = read_ply(tmp_path / "run.ply")
    range_m = np.array([v["range_m"] for v in vertices], dtype=float)
    rgb = np.array([[v[c] for c in ("red", "green", "blue")] for v in vertices])
    share = (range_m - range_m.min()) / np.ptp(range_m)
    assert np.abs(rgb - 255 * colormaps["viridis"](share)[:, :3]).max() < 20
    assert tuple(rgb[share.argmin()]) == (68, 1, 84)
    assert tuple(rgb[share.argmax()]) == (253, 231, 37)


def test_ply_of_nothing_valid_is_empty(flight, tmp_path):
    export([replace(flight, range_valid=np.zeros_like(flight.range_valid))], tmp_path / "none.ply")
    assert read_ply(tmp_path / "none.ply") == []


def test_ply_of_one_range_has_one_colour(flight, tmp_path):
    level = replace(flight, range_m=np.where(flight.range_valid, 500.0, np.nan))
    export([level], tmp_path / "level.ply")
    assert len({(v["red"], v["green"], v["blue"]) for v in read_ply(tmp_path / "level.ply")}) == 1


def test_bench_pattern_has_a_table_but_no_points(bench, tmp_path):
    export([bench], tmp_path / "bench.csv")
    assert len((tmp_path / "bench.csv").read_text().splitlines()) == 1 + bench.fired.size
    with pytest.raises(InputError, match="a bench pattern has no points"):
        export([bench], tmp_path / "bench.ply")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("run.xlsx", r"unknown suffix \.xlsx; use \.csv, \.npz, \.parquet, \.ply$"),
        ("run", r"no suffix; use \.csv, "),
        ("nowhere/run.csv", "no such folder"),
        ("file/run.csv", "no such folder"),
        ("folder.csv", "a folder"),
    ],
)
def test_unusable_paths_are_refused_before_and_at_export(flight, tmp_path, name, message):
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "file").touch()
    for attempt in (lambda path: check_export_path(path), lambda path: export([flight], path)):
        with pytest.raises(InputError, match=message):
            attempt(tmp_path / name)


def test_parquet_without_pyarrow_names_the_extra(flight, tmp_path, monkeypatch):
    monkeypatch.setattr(files, "find_spec", lambda _: None)
    for attempt in (check_export_path, lambda path: export([flight], path)):
        with pytest.raises(InputError, match=r"pip install .*\[tables\]'$"):
            attempt(tmp_path / "run.parquet")
    check_export_path(tmp_path / "run.csv")


def test_a_failed_write_leaves_the_older_file(flight, tmp_path, monkeypatch):
    def fill_the_disk(file, **_):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    path = tmp_path / "run.npz"
    path.write_bytes(b"older")
    monkeypatch.setattr(np, "savez_compressed", fill_the_disk)
    with pytest.raises(RunError, match="No space left on device"):
        export([flight], path)
    assert path.read_bytes() == b"older"
    assert list(tmp_path.iterdir()) == [path]


def test_export_replaces_an_older_file_and_leaves_no_other(flight, tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("older")
    export([flight], path)
    assert path.read_text().startswith("shot,beam,time_s,")
    assert list(tmp_path.iterdir()) == [path]


def test_one_name_may_be_written_by_several_at_once(tmp_path):
    path = tmp_path / "run.csv"
    with files.whole_file(path) as first:
        first.write(b"first")
        with files.whole_file(path) as second:
            second.write(b"second")
        assert path.read_bytes() == b"second"
        first.write(b" and whole")
    assert path.read_bytes() == b"first and whole"
    assert list(tmp_path.iterdir()) == [path]
