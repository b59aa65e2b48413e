"""Columns of a table whose number of rows is not known beforehand."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray


class GrowingColumns:
    """Arrays that grow in place, block by block: joining blocks at the end would need twice the memory."""

    def __init__(self) -> None:
        self.arrays: dict[str, NDArray[Any]] = {}
        """Columns by name; views of them must not outlive the next `add`."""

    def add(self, block: Mapping[str, NDArray[Any]]) -> None:
        """Append rows.

        Args:
            block: the same columns in each call; shapes agree but for the first axis.
        """
        for name, rows in block.items():
            if (column := self.arrays.get(name)) is None:
                self.arrays[name] = rows.copy()
                continue
            first = len(column)
            column.resize((first + len(rows), *rows.shape[1:]), refcheck=False)
            column[first:] = rows
