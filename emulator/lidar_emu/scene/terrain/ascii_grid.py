"""Completeness of ESRI ASCII grids: GDAL reads `5x` as 5."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.files import MOST_BYTES_IN_MEMORY, check_file

_INTACT = "use an intact ESRI ASCII grid"
_IN_NUMBERS = np.zeros(256, dtype=bool)
_IN_NUMBERS[np.frombuffer(b"0123456789+-.,eEnNaAiIfF \t\r\n", dtype=np.uint8)] = True


def check_ascii_grid(path: str, rows: int, columns: int) -> None:
    """Refuse a grid with other than `rows` times `columns` numbers below its header."""
    check_file(Path(path), _INTACT, MOST_BYTES_IN_MEMORY)
    content = np.frombuffer(_below_header(Path(path).read_bytes()), dtype=np.uint8)
    other = np.flatnonzero(~_IN_NUMBERS[content])
    if other.size:
        word = bytes(content[max(0, other[0] - 10) : other[0] + 10]).split()
        text = " ".join(each.decode("ascii", "replace") for each in word)
        raise InputError(path, None, Finding(f"not a number, near {text!r}"), _INTACT)
    blank = np.concatenate([[True], content <= ord(" ")])
    count = int((blank[:-1] & ~blank[1:]).sum())
    if count != rows * columns:
        found = f"{count} numbers for {rows} rows of {columns}"
        raise InputError(path, None, Finding(found), _INTACT)


def _below_header(content: bytes) -> bytes:
    """What follows the lines of keys and values."""
    while (line := content.partition(b"\n"))[0].lstrip()[:1].isalpha() and not _is_marker(line[0]):
        content = line[2]
    return content


def _is_marker(line: bytes) -> bool:
    """Whether a line begins with a missing sample rather than with a key."""
    return line.split()[0].lower() in (b"nan", b"inf")
