"""What is carried over a fault: the last values from before it."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray

Row = NDArray[Any]
_Held = TypeVar("_Held")


def hold(values: NDArray[Any], renewed: BoolArray, before: Row | None) -> tuple[NDArray[Any], Row]:
    """The last renewed value of each place, shot by shot.

    Args:
        values: (shots, beams), consecutive shots.
        renewed: (shots, beams) where a value takes the place of what was held.
        before: (1, beams) held before the first of the shots; None: nothing yet, which stands for its own values.

    Returns:
        (shots, beams) what is held at each shot, and (1, beams) after the last.
    """
    if renewed.all():
        return values, values[-1:]
    stacked = np.concatenate([values[:1] if before is None else before, values])
    row = np.where(renewed, np.arange(1, len(values) + 1)[:, None], 0)
    held = np.take_along_axis(stacked, np.maximum.accumulate(row, axis=0), axis=0)
    return held, held[-1:]


def resumed(held: tuple[_Held, ...], initial: tuple[_Held, ...]) -> tuple[_Held, ...]:
    """What the first of several faults have carried so far, and of the others what they begin with."""
    return held + initial[len(held) :]
