"""A shot as the kernel calls that compute it, recorded once and repeated on the same arrays.

The code of a shot between its kernels and array functions only selects arrays. Their calls, with the arrays that they
read and write, are therefore the same for every shot, as long as each of them returns the recorded value; otherwise the
shot is recorded again. `FlightModel` decides which flights qualify.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from lidar_emu.beams.patterns import ScannerState, choose_patterns
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, IntArray
from lidar_emu.numerics.lazy_kernel import Kernel, recorded_calls
from lidar_emu.packed_measurement import PackedMeasurement, Rows, columns_of, empty_rows, pack

Compute = Callable[[IntArray, ScannerState], tuple[Measurement, ScannerState]]


_MOST_RECORDS, _SHOTS_PER_RECORD = 16, 50
"""A flight whose shots differ more often is computed as it is: to record a shot takes as long as many shots."""


class ShotWalk:
    """Computes single shots.

    Args:
        compute: computes the shots with these numbers (shots,) from the scanner's state before them, by kernels and
            by `ArrayFunction`s alone.
    """

    def __init__(self, compute: Compute) -> None:
        self._compute = compute
        self._shot = np.zeros(1, dtype=np.int64)
        self._calls: list[tuple[Callable[..., Any], tuple[Any, ...], Any]] = []
        self._active: BoolArray | None = None
        self._commanded: int | None = None
        self._rows: Rows = ()
        self._beams = self._records = self._repeated = 0

    def measure(self, shot: int, state: ScannerState) -> tuple[Measurement, ScannerState]:
        """Measure a shot from the scanner's state before it; also returns the state after it."""
        if self._records > _MOST_RECORDS + self._repeated // _SHOTS_PER_RECORD:
            return self._compute(np.array([shot]), state)
        self._shot[0] = shot
        if not self._calls or state.commanded != self._commanded or not self._repeat(state):
            self._records += 1
            return self._record(state)
        self._repeated += 1
        if self._active is not None and (active := tuple(self._active.tolist())) != state.active:
            state = replace(state, active=active)
        return self._copied(), state

    def _repeat(self, state: ScannerState) -> bool:
        """Repeat the calls; return False as soon as one returns another value than recorded."""
        if self._active is not None:
            self._active[:] = state.active
        for call, args, result in self._calls:  # noqa: SIM110 - half a microsecond less than all()
            if call(*args) != result:
                return False
        return True

    def _record(self, state: ScannerState) -> tuple[Measurement, ScannerState]:
        self._compute(self._shot, state)  # which may allocate the receiver's arrays
        with recorded_calls() as calls:
            measurement, after = self._compute(self._shot, state)
            self._beams = measurement.beam_count
            self._rows = empty_rows(1, self._beams)
            pack(columns_of(measurement), self._rows)
        if any(isinstance(call.kernel, Kernel) for call in calls):  # not where kernels are interpreted
            self._calls = [(call.kernel.entry(call.args), call.args, call.result) for call in calls]
        self._commanded = state.commanded
        # The states of the switches, an array that is updated; None without switches.
        self._active = next((call.args[5] for call in calls if call.kernel is choose_patterns), None)
        return self._copied(), after

    def _copied(self) -> Measurement:
        return PackedMeasurement.of(tuple([row.copy() for row in self._rows]), self._beams)
