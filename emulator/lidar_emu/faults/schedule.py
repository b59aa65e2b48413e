"""Fault schedules: whether a fault acts is a function of shot, beam and seed alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.random_streams import RandomStream, fault_purpose
from lidar_emu.scenario.faults import LinkFault, ScheduledFault
from lidar_emu.scenario.faults.beams import PerBeamFault

_Draw = Callable[[NDArray[np.int64]], FloatArray]


class FaultOccurrence(NamedTuple):
    """A fault that acted on a shot."""

    shot: int
    fault: int
    """Index in the scenario's list of faults."""
    kind: str
    beams: tuple[int, ...]
    """Beams on which the fault acted; empty unless it acts on beams."""


class FaultSchedule:
    """Schedule of one fault of a scenario.

    Args:
        fault: fault as the scenario defines it.
        stream: random stream of the fault.
        period_ns: shot period.
    """

    def __init__(self, fault: ScheduledFault | LinkFault, stream: RandomStream, period_ns: int) -> None:
        self._stream = stream
        self._period_ns = period_ns
        self._probability = fault.probability
        # Rounded up to whole shots, and at least one: a duration of half a period affects one shot.
        self._duration_shots = max(1, -(-round(fault.lasts_s * 1e9) // period_ns))
        if fault.at_s is not None:
            self._first = self._first_shot_from(fault.at_s)
            self._end = self._first + 1
        else:
            self._first = self._first_shot_from(fault.from_s)
            self._end = np.iinfo(np.int64).max if fault.to_s is None else self._first_shot_from(fault.to_s)

    def has_begun(self, shot: int) -> bool:
        """Whether the fault window has begun by this shot."""
        return shot >= self._first

    def has_ended(self, shot: int) -> bool:
        """Whether the fault window has ended by this shot."""
        return shot >= self._end

    def active_shots(self, shot: NDArray[np.int64]) -> BoolArray:
        """(shots,) Whether the fault acts on each of consecutive shots, with one draw for the whole shot."""
        return self._active(shot, lambda drawn: self._stream.per_shot(drawn)[:, None])[:, 0]

    def active_beams(self, shot: NDArray[np.int64], beam_count: int) -> BoolArray:
        """(shots, beams) Whether the fault acts on each beam of consecutive shots, with one draw for each beam."""
        active = self._active(shot, lambda drawn: self._stream.uniforms(drawn, beam_count, 0)[..., 0])
        return np.broadcast_to(active, (len(shot), beam_count))

    def elapsed_s(self, shot: NDArray[np.int64]) -> FloatArray:
        """(shots,) Time since the start of the first shot in the fault window."""
        return np.asarray((shot - self._first) * (self._period_ns * 1e-9), dtype=np.float64)

    def _first_shot_from(self, time_s: float) -> int:
        return -(-round(time_s * 1e9) // self._period_ns)

    def _active(self, shot: NDArray[np.int64], draw: _Draw) -> BoolArray:
        inside = ((shot >= self._first) & (shot < self._end))[:, None]
        if self._probability >= 1 or not inside.any():
            return inside
        # An onset acts for `_duration_shots` shots: earlier shots of the window are drawn again.
        before = min(self._duration_shots - 1, int(shot[0]) - self._first)
        drawn = np.arange(int(shot[0]) - max(0, before), int(shot[-1]) + 1)
        onsets = (draw(drawn) < self._probability) & (drawn >= self._first)[:, None]
        total = np.concatenate([np.zeros((1, onsets.shape[1]), dtype=np.int64), onsets.cumsum(axis=0)])
        last = shot - drawn[0] + 1
        return np.asarray(inside & (total[last] > total[np.maximum(0, last - self._duration_shots)]))


class FaultInstance:
    """A fault of light, receiver or beams in a run: its definition, random stream, schedule and beams.

    Args:
        index: index in the scenario's list of faults.
        fault: fault as the scenario defines it.
        seed: seed of the run.
        period_ns: shot period.
        beam_count: beams of a shot.
    """

    def __init__(self, index: int, fault: ScheduledFault, seed: int, period_ns: int, beam_count: int) -> None:
        self.index = index
        self.fault: Any = fault
        self.stream = RandomStream(seed, fault_purpose(index))
        self.schedule = FaultSchedule(fault, self.stream, period_ns)
        self._beams = np.ones(beam_count, dtype=np.bool_)
        if isinstance(fault, PerBeamFault) and fault.beams is not None:
            self._beams[:] = False
            self._beams[fault.beams] = True

    def affected_beams(self, shot: NDArray[np.int64], fired: BoolArray) -> BoolArray:
        """(shots, beams) Fired beams on which the fault acts."""
        if not self.schedule.has_begun(int(shot[-1])) or self.schedule.has_ended(int(shot[0])):
            return np.zeros_like(fired)
        if isinstance(self.fault, PerBeamFault):
            return self.schedule.active_beams(shot, len(self._beams)) & fired & self._beams
        return self.schedule.active_shots(shot)[:, None] & fired

    def ramp(self, shot: NDArray[np.int64]) -> FloatArray:
        """(shots, 1) Fraction of the full magnitude, which grows linearly for `ramp_s` from the start of the window."""
        ramp_s = getattr(self.fault, "ramp_s", 0.0)
        if ramp_s == 0:
            return np.ones((len(shot), 1))
        return np.minimum(1.0, self.schedule.elapsed_s(shot) / ramp_s)[:, None]
