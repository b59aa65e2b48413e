"""When a fault acts: a function of shot, beam and seed alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.random_streams import RandomStream, fault_purpose
from lidar_emu.scenario.faults import LinkFault, ScheduledFault
from lidar_emu.scenario.faults.timing import PerBeamFault

_Draw = Callable[[NDArray[np.int64]], FloatArray]


class FaultOccurrence(NamedTuple):
    """A fault that acted on a shot."""

    shot: int
    fault: int
    """Its place in the scenario's list."""
    kind: str
    beams: tuple[int, ...]
    """Of a fault of beams, those on which it acted; else empty."""


class FaultSchedule:
    """When one fault of a scenario acts.

    Args:
        fault: what the scenario says.
        stream: its random numbers.
        period_ns: from shot to shot.
    """

    def __init__(self, fault: ScheduledFault | LinkFault, stream: RandomStream, period_ns: int) -> None:
        self._stream = stream
        self._period_ns = period_ns
        self._probability = fault.probability
        # At least one shot, begun or not: whoever asks for a spell of half a period gets a shot.
        self._lasts = max(1, -(-round(fault.lasts_s * 1e9) // period_ns))
        if fault.at_s is not None:
            self._first = self._shot_at(fault.at_s)
            self._end = self._first + 1
        else:
            self._first = self._shot_at(fault.from_s)
            self._end = np.iinfo(np.int64).max if fault.to_s is None else self._shot_at(fault.to_s)

    def begins_by(self, shot: int) -> bool:
        """Whether the window has begun."""
        return shot >= self._first

    def is_over(self, shot: int) -> bool:
        """Whether the window has ended."""
        return shot >= self._end

    def shots(self, shot: NDArray[np.int64]) -> BoolArray:
        """(shots,) On which of consecutive shots it acts, as one."""
        return self._spells(shot, lambda asked: self._stream.per_shot(asked)[:, None])[:, 0]

    def beams(self, shot: NDArray[np.int64], beam_count: int) -> BoolArray:
        """(shots, beams) On which beams of consecutive shots it acts, each by its own chance."""
        acts = self._spells(shot, lambda asked: self._stream.uniforms(asked, beam_count, 0)[..., 0])
        return np.broadcast_to(acts, (len(shot), beam_count))

    def since_s(self, shot: NDArray[np.int64]) -> FloatArray:
        """(shots,) Time since the first shot of the window began."""
        return np.asarray((shot - self._first) * (self._period_ns * 1e-9), dtype=np.float64)

    def grown(self, shot: NDArray[np.int64], ramp_s: float) -> FloatArray:
        """(shots, 1) Part of its full size that it has, if it grows so long from the start of the window."""
        if ramp_s == 0:
            return np.ones((len(shot), 1))
        return np.minimum(1.0, self.since_s(shot) / ramp_s)[:, None]

    def _shot_at(self, time_s: float) -> int:
        """The first shot that begins then or later."""
        return -(-round(time_s * 1e9) // self._period_ns)

    def _spells(self, shot: NDArray[np.int64], draw: _Draw) -> BoolArray:
        inside = ((shot >= self._first) & (shot < self._end))[:, None]
        if self._probability >= 1 or not inside.any():
            return inside
        # A shot is hit by whatever set in so many shots before it, at the earliest where the window starts.
        before = min(self._lasts - 1, int(shot[0]) - self._first)
        asked = np.arange(int(shot[0]) - max(0, before), int(shot[-1]) + 1)
        sets_in = (draw(asked) < self._probability) & (asked >= self._first)[:, None]
        total = np.concatenate([np.zeros((1, sets_in.shape[1]), dtype=np.int64), sets_in.cumsum(axis=0)])
        last = shot - asked[0] + 1
        return np.asarray(inside & (total[last] > total[np.maximum(0, last - self._lasts)]))


class FaultInstance:
    """A fault of light, of the receiver or of beams, with when it acts.

    Args:
        number: its place in the scenario's list.
        fault: what the scenario says.
        seed: of the run.
        period_ns: from shot to shot.
        beam_count: beams of a shot.
    """

    def __init__(
        self, number: int, fault: ScheduledFault, seed: int, period_ns: int, beam_count: int
    ) -> None:
        self.number = number
        self.fault: Any = fault
        self.stream = RandomStream(seed, fault_purpose(number))
        self.schedule = FaultSchedule(fault, self.stream, period_ns)
        self._beams = np.ones(beam_count, dtype=np.bool_)
        if isinstance(fault, PerBeamFault) and fault.beams is not None:
            self._beams[:] = False
            self._beams[fault.beams] = True

    def hit(self, shot: NDArray[np.int64], fired: BoolArray) -> BoolArray:
        """(shots, beams) Beams that have fired and on which it acts."""
        if not self.schedule.begins_by(int(shot[-1])) or self.schedule.is_over(int(shot[0])):
            return np.zeros_like(fired)
        if isinstance(self.fault, PerBeamFault):
            return self.schedule.beams(shot, len(self._beams)) & fired & self._beams
        return self.schedule.shots(shot)[:, None] & fired

    def grown(self, shot: NDArray[np.int64]) -> FloatArray:
        """(shots, 1) Part of its full size that it has, if it is one that grows."""
        return self.schedule.grown(shot, getattr(self.fault, "ramp_s", 0.0))
