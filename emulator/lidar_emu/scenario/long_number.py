"""Numbers too long to be read: Python takes the square of their length for whole ones."""

from __future__ import annotations

MOST_CHARACTERS = 100


class LongNumber(str):
    """Text of a number of more than `MOST_CHARACTERS`, which no key takes."""

    __slots__ = ()
