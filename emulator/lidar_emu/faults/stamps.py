"""Faults of clock and counter: what packets are stamped with. What was measured, and when, stays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lidar_emu.faults.chance import Chance
from lidar_emu.faults.hold import Row, hold
from lidar_emu.faults.schedule import Injected, Schedule
from lidar_emu.measurement import Measurement
from lidar_emu.scenario import faults as kinds

StampState = tuple[Row | None, ...]
"""By each fault: the last number of a shot from before it."""


class StampFaults:
    """All faults of clock and counter.

    Args:
        numbered: the faults, with their places in the scenario's list.
        seed: of the run.
        period_ns: from shot to shot.
    """

    def __init__(self, numbered: Sequence[tuple[int, kinds.StampFault]], seed: int, period_ns: int) -> None:
        self._faults = [
            (number, fault, Schedule(fault, Chance(seed, number), period_ns)) for number, fault in numbered
        ]
        self.initial: StampState = (None,) * len(self._faults)
        """What is carried before shot 0."""

    def apply(
        self, shot: NDArray[np.int64], block: Measurement, state: StampState
    ) -> tuple[Measurement, StampState, list[Injected]]:
        """The shots as they are stamped, what is carried on, and which faults acted.

        Args:
            shot: (shots,) the scenario's numbers of the shots; those in `block` are the device's.
            block: as the device would stamp them.
            state: carried from the shots before.
        """
        time_ns, counter = block.time_ns, block.shot
        injected: list[Injected] = []
        after: list[Row | None] = []
        for (number, fault, schedule), before in zip(self._faults, state, strict=True):
            acts = schedule.shots(shot)
            carried = None
            if isinstance(fault, kinds.FrozenCounter):
                counter, carried = _frozen(counter, acts, before)
            else:
                shifted_ns = np.maximum(0, time_ns + round(fault.jump_s * 1e9))
                time_ns = np.where(acts[:, None], shifted_ns, time_ns)
            after.append(carried)
            injected += [Injected(hit, number, fault.kind, ()) for hit in shot[acts].tolist()]
        return replace(block, time_ns=time_ns, shot=counter), tuple(after), injected


def _frozen(
    counter: NDArray[np.int64], acts: NDArray[np.bool_], before: Row | None
) -> tuple[NDArray[np.int64], Row]:
    held, carried = hold(counter[:, None], ~acts[:, None], before)
    return held[:, 0], carried
