"""What each beam measured, and its error, over time."""

from __future__ import annotations

import numpy as np

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray


def beam_values(measured: Measurement) -> dict[str, FloatArray]:
    """Values by name, each (shots, beams), NaN where invalid."""
    range_m = np.where(measured.range_valid, measured.range_m, np.nan)
    speed_mps = np.where(measured.speed_valid, measured.closing_speed_mps, np.nan)
    return {
        "range_m": range_m,
        "closing_speed_mps": speed_mps,
        "range_error_m": range_m - measured.true_range_m,
        "closing_speed_error_mps": speed_mps - measured.true_closing_speed_mps,
    }
