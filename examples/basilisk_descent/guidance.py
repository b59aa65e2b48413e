"""Guidance: from an estimate to thrust. It brakes to walking pace, stops the drift and estimates the vertical."""

from math import sqrt

import numpy as np
from estimate import Array, Estimate

GRAVITY_MPS2 = 1.623
BRAKING_MPS2 = 0.7
SLOW_BELOW_M, SLOWEST_MPS = 10.0, 1.0
STEEPEST_TILT = 0.27  # tangent of 15 degrees
CLIMB_GAIN_PER_S, DRIFT_GAIN_PER_S, TRIM_GAIN_PER_S2 = 0.8, 0.6, 0.15


class Guidance:
    """Thrust proportional to the error of the climb rate and to the drift.

    The ground's normal is not the vertical: thrust along it would accelerate the vehicle down every slope. The
    correction is integrated from the remaining drift, and kept as a trim.
    """

    def __init__(self) -> None:
        self._trim_body_mps2 = np.zeros(3)

    def thrust(self, estimate: Estimate, step_s: float) -> Array:
        """Thrust per mass along the body's axes.

        Args:
            step_s: time since the last call.
        """
        upward_mps2 = _upward(estimate)
        drift_mps = estimate.drift_body_mps
        sideways_mps2 = -DRIFT_GAIN_PER_S * drift_mps - self._trim_body_mps2
        steepness = float(np.linalg.norm(sideways_mps2)) / (STEEPEST_TILT * upward_mps2)
        if steepness > 1:
            sideways_mps2 /= steepness
        else:  # At the tilt limit drift remains on any slope, and must not be integrated.
            self._trim_body_mps2 += TRIM_GAIN_PER_S2 * step_s * drift_mps
        return upward_mps2 * estimate.up_body + sideways_mps2


def _upward(estimate: Estimate) -> float:
    """Upward thrust against gravity, for a descent with constant deceleration."""
    above_m = max(0.0, estimate.height_m - SLOW_BELOW_M)
    wanted_climb_mps = -sqrt(SLOWEST_MPS**2 + 2 * BRAKING_MPS2 * above_m)
    braking_mps2 = BRAKING_MPS2 if above_m > 0 else 0.0
    correction_mps2 = CLIMB_GAIN_PER_S * (wanted_climb_mps - estimate.climb_mps)
    return min(max(GRAVITY_MPS2 + braking_mps2 + correction_mps2, 0.3 * GRAVITY_MPS2), 2.5 * GRAVITY_MPS2)
