"""Temperature of the device: exponential approach to the equilibrium with the laser on or off."""

from __future__ import annotations

import math
from typing import NamedTuple

# Nothing depends on the temperature: housekeeping shows a device that warms up.
AMBIENT_C, RISE_K, TIME_CONSTANT_S = 20.0, 12.0, 240.0


class ThermalState(NamedTuple):
    """The excess over the ambient temperature when the laser was switched last, and whether it was switched on."""

    since_ns: int
    excess_k: float
    laser_on: bool

    def temperature_c(self, time_ns: int) -> float:
        """Temperature at a time from `since_ns` on; before, the temperature at `since_ns`."""
        return AMBIENT_C + self._excess_k(time_ns)

    def switched(self, laser_on: bool, time_ns: int) -> ThermalState:
        """The state after the laser was switched on or off."""
        if laser_on == self.laser_on:
            return self
        return ThermalState(time_ns, self._excess_k(time_ns), laser_on)

    def _excess_k(self, time_ns: int) -> float:
        final_k = RISE_K if self.laser_on else 0.0
        elapsed_s = max(0, time_ns - self.since_ns) * 1e-9
        return final_k + (self.excess_k - final_k) * math.exp(-elapsed_s / TIME_CONSTANT_S)
