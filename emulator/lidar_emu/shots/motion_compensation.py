"""Correction of measurements for the vehicle's motion, from what the instrument has measured.

An instrument knows the errors of `receiver.motion_errors`: they follow from its range, its closing speed, and the rate
of that, which the speeds of consecutive shots along the same axis show. As their noise enters the range, accelerations
are averaged over `SMOOTHED_S` where shots follow faster.
"""

from __future__ import annotations

from dataclasses import replace
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray, as_record
from lidar_emu.numerics.kernels import kernel
from lidar_emu.receiver.motion_errors import build_motion_errors, motion_error
from lidar_emu.scenario.instrument import Instrument

SMOOTHED_S = 0.05
"""Time constant of the average of accelerations."""

LONGEST_GAP_S = 0.5
"""Time without a valid speed after which the acceleration is unknown."""

FASTEST_MPS2 = 100.0
"""Acceleration beyond which one of two speeds is of a wrong lock."""

_SETTLED = 0.9
"""Weight of all accelerations in the average from which it is used."""

_SPEED, _MEAN, _WEIGHT, _X, _Y, _Z = range(6)


class SpeedMemory(NamedTuple):
    """What is kept of each beam from shot to shot; never changed in place."""

    time_ns: NDArray[np.int64]
    """(beams,) Time of the last valid speed, -1 before."""
    values: FloatArray
    """(beams, 6) That speed, the average of accelerations and its weight, and the published axis."""


class MotionCompensation:
    """Corrects ranges and closing speeds.

    Args:
        instrument: the instrument.
        beam_count: number of beams.
    """

    def __init__(self, instrument: Instrument, beam_count: int) -> None:
        self._errors = as_record(build_motion_errors(instrument))
        self.initial = SpeedMemory(np.full(beam_count, -1, dtype=np.int64), np.zeros((beam_count, 6)))

    def apply(self, measured: Measurement, memory: SpeedMemory) -> tuple[Measurement, SpeedMemory]:
        """Correct consecutive shots; also return the memory after them."""
        kept = SpeedMemory(memory.time_ns.copy(), memory.values.copy())
        columns = {
            name: np.array(getattr(measured, name))
            for name in ("range_m", "second_range_m", "sigma_range_m", "closing_speed_mps", "sigma_speed_mps")
        }
        correct: Any = _correct
        correct(
            self._errors,
            np.ascontiguousarray(measured.time_ns),
            np.ascontiguousarray(measured.speed_valid & measured.sign_resolved),
            np.ascontiguousarray(measured.beam_axis_body),
            tuple(columns.values()),
            kept.time_ns,
            kept.values,
        )
        return replace(measured, **columns), kept


@kernel(outermost=True)
def _correct(
    error_laws: NDArray[Any],
    time_ns: NDArray[np.int64],
    known: NDArray[np.bool_],
    axes: FloatArray,
    columns: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
    last_ns: NDArray[np.int64],
    values: FloatArray,
) -> None:
    errors = error_laws[0]
    range_m, second_m, sigma_m, speed_mps, sigma_mps = columns
    for s in range(len(time_ns)):
        for b in range(len(last_ns)):
            if not known[s, b]:
                continue
            speed = speed_mps[s, b]
            variance, acceleration = 0.0, 0.0
            after_s = 1e-9 * (time_ns[s, b] - last_ns[b])
            if _follows(last_ns[b], after_s, speed, axes[s, b], values[b]):
                share = min(1.0, after_s / SMOOTHED_S)
                step = (speed - values[b, _SPEED]) / after_s
                values[b, _MEAN] += share * (step - values[b, _MEAN])
                values[b, _WEIGHT] += share * (1.0 - values[b, _WEIGHT])
                if values[b, _WEIGHT] >= _SETTLED:
                    acceleration = values[b, _MEAN] / values[b, _WEIGHT]
                    # The average is the speed less the average of speeds, times share/after_s.
                    variance = (share / after_s * sigma_mps[s, b]) ** 2 * 2.0 / (2.0 - share)
            else:
                values[b, _MEAN] = values[b, _WEIGHT] = 0.0
            last_ns[b], values[b, _SPEED] = time_ns[s, b], speed
            values[b, _X], values[b, _Y], values[b, _Z] = axes[s, b, 0], axes[s, b, 1], axes[s, b, 2]
            longer_m, faster_mps = motion_error(errors, range_m[s, b], speed, acceleration)
            range_m[s, b] -= longer_m
            second_m[s, b] -= longer_m
            sigma_m[s, b] = sqrt(sigma_m[s, b] ** 2 + errors.range_per_mps2**2 * variance)
            speed_mps[s, b] -= faster_mps


@kernel
def _follows(last_ns: int, after_s: float, speed_mps: float, axis: FloatArray, values: FloatArray) -> bool:
    """Whether a speed continues the last one, along the same axis."""
    if last_ns < 0 or not 0.0 < after_s <= LONGEST_GAP_S:
        return False
    if axis[0] != values[_X] or axis[1] != values[_Y] or axis[2] != values[_Z]:
        return False
    return bool(abs(speed_mps - values[_SPEED]) <= FASTEST_MPS2 * after_s)
