"""Columns of numbers from a CSV file with a header; unusable cells are refused by line and column."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from itertools import islice
from math import isfinite
from pathlib import Path

import numpy as np

from lidar_emu.errors import Finding, InputError, reason_of
from lidar_emu.files import check_file
from lidar_emu.numerics.arrays import FloatArray

_READABLE = "use a readable CSV file"
_MOST_BYTES, _MOST_ROWS = 1_000_000_000, 10_000_000
"""Almost three hours at 1 kHz."""


@dataclass(frozen=True)
class CsvRows:
    """A file's header and rows, as text."""

    file: str
    header: list[str]
    lines: list[int]
    """Line number of each row in the file."""
    rows: list[list[str]]

    def column(self, name: str) -> FloatArray:
        """Numbers (n,) of a column; NaN where a cell is empty.

        Raises:
            InputError: the header has no such column or has it twice, or a cell is not a finite number.
        """
        if self.header.count(name) != 1:
            known = ", ".join(self.header)
            raise InputError(
                self.file, "column", name, f"must be a name that the header has once, of {known}"
            )
        place = self.header.index(name)
        cells = [row[place] if place < len(row) else "" for row in self.rows]
        return np.array([self._number(name, *cell) for cell in zip(self.lines, cells, strict=True)])

    def refusal(self, row: int, name: str, value: object, remedy: str) -> InputError:
        """Error for an unusable cell."""
        return InputError(self.file, f"line {self.lines[row]}, {name}", value, remedy)

    def _number(self, name: str, line: int, text: str) -> float:
        if not text:
            return np.nan
        try:
            # Python also reads 1_000.
            number = np.nan if "_" in text else float(text)
        except ValueError:
            number = np.nan
        if not isfinite(number):
            raise InputError(self.file, f"line {line}, {name}", text, "must be a finite number or empty")
        return number


def read_csv(file: str) -> CsvRows:
    """Read the header and rows of a file; blanks around cells are stripped and empty lines skipped.

    Raises:
        InputError: the file is unreadable, empty or not CSV text, or a row is longer than the header.
    """
    check_file(Path(file), _READABLE, _MOST_BYTES)
    try:
        with Path(file).open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.reader(stream, strict=True)
            table = [
                (reader.line_num, [cell.strip() for cell in row]) for row in islice(reader, _MOST_ROWS + 1)
            ]
    except OSError as error:
        raise InputError(file, None, Finding(reason_of(error)), _READABLE) from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(file, None, Finding(str(error)), "use CSV as UTF-8 text") from None
    if len(table) > _MOST_ROWS:
        raise InputError(file, None, Finding(f"more than {_MOST_ROWS} rows"), "split it")
    filled = [(line, row) for line, row in table if any(row)]
    if not filled:
        raise InputError(file, None, Finding("an empty file"), "write a header and at least 2 rows")
    (_, header), *body = filled
    for line, row in body:
        if any(row[len(header) :]):
            found = Finding(f"{len(row)} cells")
            raise InputError(file, f"line {line}", found, f"write {len(header)}, as in the header")
    return CsvRows(file, header, [line for line, _ in body], [row for _, row in body])
