"""The device's temperature: an exponential approach to one of two values, by whether the laser is on."""

from __future__ import annotations

import math
from typing import NamedTuple


class Heating(NamedTuple):
    """How a device warms up."""

    ambient_c: float
    rise_k: float
    time_constant_s: float
    limit_c: float | None


class Heat(NamedTuple):
    """The excess over the ambient temperature when the laser was switched last, and whether it was switched on."""

    since_ns: int
    excess_k: float
    laser_on: bool

    def temperature_c(self, heating: Heating, time_ns: int) -> float:
        """Of the device, at a time from `since_ns` on; before it, as then."""
        return heating.ambient_c + self._excess_k(heating, time_ns)

    def switched(self, heating: Heating, laser_on: bool, time_ns: int) -> Heat:
        """After the laser was switched on or off."""
        if laser_on == self.laser_on:
            return self
        return Heat(time_ns, self._excess_k(heating, time_ns), laser_on)

    def reaches_limit_ns(self, heating: Heating) -> int | None:
        """When it becomes too hot, if the laser stays on; None: never."""
        if heating.limit_c is None or not self.laser_on:
            return None
        allowed_k = heating.limit_c - heating.ambient_c
        if self.excess_k >= allowed_k:
            return self.since_ns
        if heating.rise_k <= allowed_k:
            return None
        wait_s = heating.time_constant_s * math.log(
            (heating.rise_k - self.excess_k) / (heating.rise_k - allowed_k)
        )
        return self.since_ns + math.ceil(wait_s * 1e9)

    def _excess_k(self, heating: Heating, time_ns: int) -> float:
        final_k = heating.rise_k if self.laser_on else 0.0
        elapsed_s = max(0, time_ns - self.since_ns) * 1e-9
        return final_k + (self.excess_k - final_k) * math.exp(-elapsed_s / heating.time_constant_s)
