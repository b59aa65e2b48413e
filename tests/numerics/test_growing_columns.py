"""Columns that grow block by block."""

from __future__ import annotations

import tracemalloc

import numpy as np

from lidar_emu.numerics.arrays import GrowingColumns


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
