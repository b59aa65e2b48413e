"""Faults of clock, counter and units: what stands in packets. What was measured, and when, stays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.faults.held_values import Row, hold
from lidar_emu.faults.schedule import FaultOccurrence, FaultSchedule
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.random_streams import RandomStream, fault_purpose
from lidar_emu.scenario import faults as kinds

_IN_METRES = (
    "range_m",
    "closing_speed_mps",
    "second_range_m",
    "sigma_range_m",
    "sigma_speed_mps",
    "residual_mps",
)

ContentState = tuple[Row | None, ...]
"""By each fault: the last number of a shot from before it."""


class ContentFaults:
    """All faults of clock, counter and units.

    Args:
        numbered: the faults, with their places in the scenario's list.
        seed: of the run.
        period_ns: from shot to shot.
    """

    def __init__(self, numbered: Sequence[tuple[int, kinds.ContentFault]], seed: int, period_ns: int) -> None:
        self._faults = [
            (number, fault, FaultSchedule(fault, RandomStream(seed, fault_purpose(number)), period_ns))
            for number, fault in numbered
        ]
        self.initial: ContentState = (None,) * len(self._faults)
        """What is carried before shot 0."""

    def apply(
        self, shot: NDArray[np.int64], block: Measurement, state: ContentState
    ) -> tuple[Measurement, ContentState, list[FaultOccurrence]]:
        """The shots as they are stamped, what is carried on, and which faults acted.

        Args:
            shot: (shots,) the scenario's numbers of the shots; those in `block` are the device's.
            block: as the device would stamp them.
            state: carried from the shots before.
        """
        injected, after = list[FaultOccurrence](), list[Row | None]()
        for (number, fault, schedule), before in zip(self._faults, state, strict=True):
            acts, carried = schedule.shots(shot), None
            match fault:
                case kinds.FrozenCounter():
                    counter, carried = _frozen(block.shot, acts, before)
                    block = replace(block, shot=counter)
                case kinds.TimeJump():
                    shifted_ns = np.maximum(0, block.time_ns + round(fault.jump_s * 1e9))
                    block = replace(block, time_ns=np.where(acts[:, None], shifted_ns, block.time_ns))
                case kinds.WrongUnit():
                    block = _in_other_units(block, acts, fault.metres)
            after.append(carried)
            injected += [FaultOccurrence(int(k), number, fault.kind, ()) for k in shot[acts]]
        return block, tuple(after), injected


def _in_other_units(block: Measurement, acts: NDArray[np.bool_], metres: float) -> Measurement:
    if not acts.any():
        return block
    factor = np.where(acts, 1 / metres, 1.0)[:, None]
    columns: dict[str, Any] = {name: factor * getattr(block, name) for name in _IN_METRES}
    return replace(block, **columns)


def _frozen(
    counter: NDArray[np.int64], acts: NDArray[np.bool_], before: Row | None
) -> tuple[NDArray[np.int64], Row]:
    held, carried = hold(counter[:, None], ~acts[:, None], before)
    return held[:, 0], carried
