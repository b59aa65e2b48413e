"""Structures as arguments of kernels: constants as one record, arrays as separate arguments.

Passing a record (a structured array of one element) to a kernel costs as much as passing an array. Between kernels a
named tuple of arrays costs nothing; from Python it costs up to 5 µs more per call than its arrays, longer than many
kernels take. The outermost kernel of a model therefore takes such arrays as a plain tuple, which costs about 0.2 µs
more than separate arguments, and builds the named tuple in its first line. Kernels that cast a few rays within 1 or 2
µs take the arrays of `Hits` as separate arguments, nine to twelve in all: for a plane and four rays a call takes
0.66 µs, with a record of the plane's constants 0.80 µs, with a tuple of the arrays 0.84 µs. A table of constants, such
as the legs of a path, is one record array.
"""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Any

import numpy as np

from lidar_emu.numerics.kernels import with_fields


@lru_cache(maxsize=64)
def as_record(fields: Any) -> Any:
    """Convert a named tuple of numbers, possibly nested, to a structured array of one element."""
    return with_fields(np.array([fields], dtype=_record_type(fields)))


def _record_type(fields: Any) -> np.dtype[Any]:
    return _dtype(
        tuple((name, _field_type(value)) for name, value in zip(fields._fields, fields, strict=True))
    )


@cache
def _dtype(fields: tuple[tuple[str, np.dtype[Any]], ...]) -> np.dtype[Any]:
    """The single dtype object of all records with these fields.

    numba looks up the type of an argument by its dtype: the same object is found at once, an equal one only after a
    comparison field by field, which takes 0.7 µs in each call from Python.
    """
    return np.dtype(list(fields), align=True)


def _field_type(value: Any) -> np.dtype[Any]:
    if not isinstance(value, tuple):
        return np.dtype(type(value))
    return _record_type(value) if hasattr(value, "_fields") else np.dtype((float, len(value)))
