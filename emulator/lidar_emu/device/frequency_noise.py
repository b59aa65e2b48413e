"""Frequency noise of an oscillator: a sum of slow sines with random phases, close to flicker noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

_PERIODS_NS = tuple(1e9 * period_s for period_s in np.geomspace(20.0, 20_000.0, 10).tolist())
"""Equal amplitudes on a logarithmic scale, as in flicker frequency noise, whose Allan deviation is constant."""

_Time = TypeVar("_Time", float, NDArray[np.floating[Any]])


@dataclass(frozen=True)
class FrequencyNoise:
    """A fractional frequency error of `amplitude` times the sum of the sines."""

    amplitude: float
    """Amplitude of each sine, as a fraction of the frequency."""
    phases: tuple[float, ...]
    """Phases at power-up, in radians."""

    @classmethod
    def drawn(cls, rms: float, seed: int) -> Self | None:
        """The noise of this seed, with a long-term RMS of `rms`; None for 0."""
        if rms == 0.0:
            return None
        from lidar_emu.numerics.random_streams import CLOCK_WANDER, RandomStream

        phases = math.tau * RandomStream(seed, CLOCK_WANDER).sequence(0, 0, len(_PERIODS_NS))
        return cls(rms * math.sqrt(2 / len(_PERIODS_NS)), tuple(phases.tolist()))

    def gained_ns(self, from_ns: float, to_ns: _Time) -> _Time:
        """Frequency error, integrated between two times from power-up."""
        gained_ns = 0.0 * to_ns
        for period_ns, phase in zip(_PERIODS_NS, self.phases, strict=True):
            turn = math.tau / period_ns
            before, after = np.cos(turn * from_ns + phase), np.cos(turn * to_ns + phase)
            gained_ns = gained_ns + self.amplitude / turn * (before - after)
        return gained_ns
