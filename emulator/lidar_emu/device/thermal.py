"""Temperature of the device: exponential approach to the equilibrium with the laser on or off."""

from __future__ import annotations

import math
from typing import NamedTuple


class ThermalModel(NamedTuple):
    """First-order thermal model."""

    ambient_c: float
    rise_k: float
    time_constant_s: float
    limit_c: float | None


class ThermalState(NamedTuple):
    """The excess over the ambient temperature when the laser was switched last, and whether it was switched on."""

    since_ns: int
    excess_k: float
    laser_on: bool

    def temperature_c(self, model: ThermalModel, time_ns: int) -> float:
        """Temperature at a time from `since_ns` on; before, the temperature at `since_ns`."""
        return model.ambient_c + self._excess_k(model, time_ns)

    def switched(self, model: ThermalModel, laser_on: bool, time_ns: int) -> ThermalState:
        """The state after the laser was switched on or off."""
        if laser_on == self.laser_on:
            return self
        return ThermalState(time_ns, self._excess_k(model, time_ns), laser_on)

    def reaches_limit_ns(self, model: ThermalModel) -> int | None:
        """Time at which the limit is reached if the laser stays on; None: never."""
        if model.limit_c is None or not self.laser_on:
            return None
        allowed_k = model.limit_c - model.ambient_c
        if self.excess_k >= allowed_k:
            return self.since_ns
        if model.rise_k <= allowed_k:
            return None
        wait_s = model.time_constant_s * math.log((model.rise_k - self.excess_k) / (model.rise_k - allowed_k))
        return self.since_ns + math.ceil(wait_s * 1e9)

    def _excess_k(self, model: ThermalModel, time_ns: int) -> float:
        final_k = model.rise_k if self.laser_on else 0.0
        elapsed_s = max(0, time_ns - self.since_ns) * 1e-9
        return final_k + (self.excess_k - final_k) * math.exp(-elapsed_s / model.time_constant_s)
