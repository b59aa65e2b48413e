"""What goes into the receiver and what comes out of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class Echoes:
    """What arrives from each beamlet of each beam."""

    range_m: FloatArray
    """(shots, beams, beamlets) At the time of validity; NaN where a beamlet meets nothing."""
    closing_speed_mps: FloatArray
    """(shots, beams, beamlets) Of the ground there, at the time of validity; positive toward the sensor."""
    power_w: FloatArray
    """(shots, beams, beamlets) In the mode of the local oscillator (`coherent_power_w` times the beamlet's
    share of the footprint); 0 where a beamlet meets nothing."""
    range_rate_mps: FloatArray
    """(shots, beams, beamlets) Change of `range_m` as the moving beam slides over the ground: not minus the closing
    speed, unless the beam stays on its place."""
    closing_acceleration_mps2: FloatArray
    """(shots, beams) Change of the closing speed along the moving beam, from segment to segment."""
    smear_acceleration_mps2: FloatArray
    """(shots, beams) Closing acceleration of a point of the ground, which a record sees."""
    speckle_place: FloatArray
    """(shots, beams, 2) Place of the footprint in the speckle's field, in pitches of its lattice."""
    speckle_drift_per_s: FloatArray
    """(shots, beams, 2) Its motion within a measurement."""
    fired: BoolArray
    """(shots, beams)"""
    inside: BoolArray
    """(shots, beams) The sensor is below the ground."""


@dataclass(frozen=True)
class Returns:
    """What the instrument reports: arrays (shots, beams); NaN where it has nothing to report."""

    range_m: FloatArray
    closing_speed_mps: FloatArray
    range_valid: BoolArray
    speed_valid: BoolArray
    sign_resolved: BoolArray
    """Direction of motion and folds are beyond doubt, for closing speeds up to λ fs / 4 (232.5 m/s): beyond, every
    segment looks like an alias. The estimators say by which rule."""
    reason: NDArray[np.int8]
    """A `Reason`."""
    segments: NDArray[np.uint8]
    """Segments with a detection: bit 0 up-chirp, bit 1 constant, bit 2 down-chirp."""
    snr_db: FloatArray
    """Power of the highest bin over the noise that the poles leave there, referred to a rectangular bin: with a flat
    receiver the photons detected, for a tone on its bin. Mean of the segments with a detection."""
    residual_mps: FloatArray
    """Speed from the two chirps less speed from the constant segment, λ (g₋ - g₊ - 2 g₀) / 4."""
    sigma_range_m: FloatArray
    """Standard deviation that the segments' own noise and the laser's line give; what speckle moves within a footprint
    spread over part of a bin, smear and motion come on top. Of invalid measurements none."""
    sigma_speed_mps: FloatArray
    returns: NDArray[np.uint8]
    """Targets seen in all three segments, at most 4."""
    second_range_m: FloatArray
    """Range from the second strongest target of each segment."""
    segment_peak_hz: FloatArray
    """(shots, beams, 3) Frequency of the strongest target in up-chirp, constant segment and down-chirp."""
