"""Sample and hold: the last values before a fault, kept from block to block."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray

Row = NDArray[Any]
_Held = TypeVar("_Held")


def hold(values: NDArray[Any], renewed: BoolArray, before: Row | None) -> tuple[NDArray[Any], Row]:
    """Hold the last renewed value of each beam, shot by shot.

    Args:
        values: (shots, beams) values of consecutive shots.
        renewed: (shots, beams) where a value replaces the held one.
        before: (1, beams) values held before the first shot; None: none yet, the first shot's values are taken.

    Returns:
        (shots, beams) values held at each shot, and (1, beams) values held after the last.
    """
    if renewed.all():
        return values, values[-1:]
    stacked = np.concatenate([values[:1] if before is None else before, values])
    row = np.where(renewed, np.arange(1, len(values) + 1)[:, None], 0)
    held = np.take_along_axis(stacked, np.maximum.accumulate(row, axis=0), axis=0)
    return held, held[-1:]


def extended(held: tuple[_Held, ...], initial: tuple[_Held, ...]) -> tuple[_Held, ...]:
    """State of the first faults of a list, extended by the initial state of the faults added behind them."""
    return held + initial[len(held) :]
