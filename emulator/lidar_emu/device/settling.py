"""Settling of the beams: after a change of pattern they do not fire for the settling time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import BoolArray, IntArray


class Settling(NamedTuple):
    """State carried from shot to shot."""

    pattern: int | None = None
    """Pattern of the last shot; None: unknown."""
    changed_ns: int | None = None
    """Start of the first shot with that pattern; None: long ago."""

    def settled(
        self, patterns: IntArray, first: int, period_ns: int, settling_ns: int
    ) -> tuple[BoolArray, Settling]:
        """Whether the beams have settled in each of consecutive shots, (shots,); and the state after them.

        Args:
            patterns: (shots,) number of each shot's pattern.
            first: number of the first shot.
            period_ns: from shot to shot.
            settling_ns: settling time, from the beginning of the first shot with a pattern.
        """
        pattern, changed_ns = self
        settled = np.ones(len(patterns), dtype=np.bool_)
        for row, chosen in enumerate(patterns.tolist()):
            begins_ns = (first + row) * period_ns
            if pattern is not None and chosen != pattern:
                changed_ns = begins_ns
            pattern = chosen
            settled[row] = changed_ns is None or begins_ns - changed_ns >= settling_ns
        return settled, Settling(pattern, changed_ns)
