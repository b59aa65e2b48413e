"""Random errors of the laser's sweep: a rate that differs from the nominal one moves a beat in proportion to the delay.

Chirps have a slope error of their own, and 1/f noise changes the laser's frequency during every record. Both move all
beats of a beam alike: in a chirp as another range would, in the constant segment as another closing speed.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import complex_normal
from lidar_emu.numerics.random_streams import SWEEP, WHOLE_SHOT


@kernel
def sweep_error(
    model: ReceiverModel, beam: Any, segment: int, look: int, range_m: float
) -> tuple[float, float]:
    """Draw the apparent changes of range in metres and of closing speed in metres per second in one record.

    Args:
        beam: record of the beam, `workspace.BEAM`.
        range_m: range of the echo.
    """
    variance = sweep_variance(model, segment, range_m, beam.left_out_bin2)
    if variance == 0.0:
        return 0.0, 0.0
    laser = beam.beam if model.sweep_scatter.per_beam else WHOLE_SHOT
    x, _ = complex_normal(beam.seed, beam.shot, laser, SWEEP, segment + 3 * look)
    error_bin = sqrt(2.0 * variance) * x
    if segment == 1:
        return 0.0, error_bin * model.speed_bin_mps
    return error_bin / model.beat_bin_per_m, 0.0


@kernel
def sweep_variance(model: ReceiverModel, segment: int, range_m: float, left_out_bin2: float) -> float:
    """Variance of a beat in bins squared; 0 where it is at most `left_out_bin2`."""
    scatter = model.sweep_scatter
    if segment == 1:
        deviation = scatter.speed_mps_per_m * range_m / model.speed_bin_mps
    else:
        deviation = scatter.range_per_m * range_m * model.beat_bin_per_m
    variance: float = deviation * deviation
    return variance if variance > left_out_bin2 else 0.0
