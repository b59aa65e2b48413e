"""Faults of packet contents: clock, counter and units. The measurement and its timing are not affected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.device.clock import LAST_NS
from lidar_emu.faults.held_values import Row, hold
from lidar_emu.faults.schedule import FaultOccurrence, FaultSchedule
from lidar_emu.fmcw.returns import REPORT_COLUMNS
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.random_streams import RandomStream, fault_purpose
from lidar_emu.scenario.faults import packets as kinds

_IN_METRES = tuple(name for name, column in REPORT_COLUMNS.items() if column.unit in ("m", "m/s"))

ContentState = tuple[Row | None, ...]
"""For each fault, the last shot number before it acted."""


class ContentFaults:
    """All faults of packet contents of a scenario.

    Args:
        faults: faults with their indices in the scenario's list.
        seed: seed of the run.
        period_ns: shot period.
    """

    def __init__(self, faults: Sequence[tuple[int, kinds.ContentFault]], seed: int, period_ns: int) -> None:
        self._faults = [
            (index, fault, FaultSchedule(fault, RandomStream(seed, fault_purpose(index)), period_ns))
            for index, fault in faults
        ]
        self.initial: ContentState = (None,) * len(self._faults)
        """State before shot 0."""

    def apply(
        self, shot: NDArray[np.int64], block: Measurement, state: ContentState
    ) -> tuple[Measurement, ContentState, list[FaultOccurrence]]:
        """Apply the faults to consecutive shots.

        Args:
            shot: (shots,) shot numbers of the scenario; those in `block` are the device's.
            block: shots with the device's numbers and times.
            state: state after the shots before.

        Returns:
            The shots as packets state them, the state after them, and the occurrences of faults.
        """
        occurrences, after = list[FaultOccurrence](), list[Row | None]()
        for (index, fault, schedule), before in zip(self._faults, state, strict=True):
            active, held = schedule.active_shots(shot), None
            match fault:
                case kinds.FrozenCounter():
                    counter, held = _frozen(block.shot, active, before)
                    block = replace(block, shot=counter)
                case kinds.TimeJump():
                    shifted_ns = np.clip(block.time_ns + round(fault.jump_s * 1e9), 0, LAST_NS)
                    block = replace(block, time_ns=np.where(active[:, None], shifted_ns, block.time_ns))
                case kinds.WrongUnit():
                    block = _in_other_units(block, active, fault.metres)
            after.append(held)
            occurrences += [FaultOccurrence(int(k), index, fault.kind, ()) for k in shot[active]]
        return block, tuple(after), occurrences


def _in_other_units(block: Measurement, active: NDArray[np.bool_], metres: float) -> Measurement:
    if not active.any():
        return block
    factor = np.where(active, 1 / metres, 1.0)[:, None]
    columns: dict[str, Any] = {name: factor * getattr(block, name) for name in _IN_METRES}
    return replace(block, **columns)


def _frozen(
    counter: NDArray[np.int64], active: NDArray[np.bool_], before: Row | None
) -> tuple[NDArray[np.int64], Row]:
    values, held = hold(counter[:, None], ~active[:, None], before)
    return values[:, 0], held
