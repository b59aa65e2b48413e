"""Columns that grow block by block, and records that kernels take as arguments."""

from __future__ import annotations

import tracemalloc
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import GrowingColumns, as_record


def test_columns_hold_the_rows_of_all_blocks_in_order() -> None:
    flat, deep = np.arange(30.0), np.arange(90).reshape(30, 3)
    columns = GrowingColumns()
    for first, end in ((0, 1), (1, 1), (1, 20), (20, 30)):
        columns.add({"flat": flat[first:end], "deep": deep[first:end]})
    np.testing.assert_array_equal(columns.arrays["flat"], flat)
    np.testing.assert_array_equal(columns.arrays["deep"], deep)


def test_a_block_is_copied() -> None:
    block = np.zeros(3)
    columns = GrowingColumns()
    columns.add({"x": block})
    block[:] = 1.0
    assert not columns.arrays["x"].any()


def test_growing_needs_the_memory_of_the_rows_once() -> None:
    block = {name: np.ones((1000, 4)) for name in "abcdefgh"}
    columns = GrowingColumns()
    tracemalloc.start()
    for _ in range(50):
        columns.add(block)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1.25 * sum(column.nbytes for column in columns.arrays.values())


class _Axis(NamedTuple):
    length_m: float
    cells: int


class _Grid(NamedTuple):
    east: _Axis
    corner_m: tuple[float, float, float]


def _grid(length_m: float, cells: int) -> _Grid:
    return _Grid(_Axis(length_m, cells), (1.0, 2.0, length_m))


def test_a_record_holds_the_values_of_its_tuple() -> None:
    record = as_record(_grid(3.5, 7))
    assert record.shape == (1,)
    assert record[0]["east"]["length_m"] == 3.5
    assert record[0]["east"]["cells"] == 7
    assert record[0]["corner_m"].tolist() == [1.0, 2.0, 3.5]


def test_records_of_equal_fields_share_one_dtype_object() -> None:
    """numba finds an argument's type by identity of its dtype; an equal dtype costs a comparison in every call."""
    assert as_record(_grid(3.5, 7)).dtype is as_record(_grid(4.5, 8)).dtype
