"""Largest residual g₋ - g₊ - 2 g₀ of three frequencies that belong to one surface.

A surface has one range and one speed, up to its extent within the footprint: each segment's peak may lie anywhere on
the surface's line. The residual of one surface is therefore at most

* three standard deviations by the variances of the three frequencies, with vibration,
* plus the footprint's depth, its diameter 2w times the tangent of 89 degrees of incidence: the difference of two
  ranges that the chirps may find on one slope; but no more than four standard deviations of the widest of the lines,
  since a slope widens them,
* plus the way that the lidar travels within the measurement,
* plus the line of the laser, up to its half-power points in each of the four terms,
* plus, where looks are averaged, the change of the Doppler shift between them at 30 m/s²,
* plus one bin for the segments' optical frequencies and the motion between them.

All of it follows from the instrument's keys and the measured values. A wrong lock leaves a residual anywhere between 0
and about N/4: the share that passes is about eight times the limit over N.
"""

from __future__ import annotations

from math import pi, radians, tan
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.kernels import kernel
from lidar_emu.scenario.instrument import Instrument

_STEEPEST = tan(radians(89.0))
"""Tangent of incidence up to which a footprint counts as one surface: at 89 degrees a Lambertian echo is 18 dB below
the echo at normal incidence."""

_FASTEST_MPS2 = 30.0
"""Three times the Earth's gravity: the hardest deceleration of a lander."""

_DEVIATIONS, _WIDTHS = 3.0, 4.0

_CLOSE_BIN = 1.5
"""For the segments' optical frequencies and the motion between them, where chance has many triples to choose from."""


class ResidualLimit(NamedTuple):
    """Constants of an instrument for `largest_residual_bin`."""

    waist_depth_bin: float
    """Depth of the footprint at the beam's waist, in bins of range."""
    rayleigh_range_bin: float
    """Rayleigh range in bins of range."""
    travel_per_bin: float
    """Way travelled within a measurement, in bins of range, per bin of Doppler shift."""
    constant_bin: float
    """Sum of the terms that depend on no measured value."""
    vibration_bin2: float = 0.0
    """Variance of the residual by vibration."""


def build_residual_limit(instrument: Instrument) -> ResidualLimit:
    """Compute the constants from an instrument's keys."""
    waveform, waist_m = instrument.waveform, instrument.optics.waist_radius_m
    looks = instrument.detection.looks
    change_mps = _FASTEST_MPS2 * (looks - 1) * waveform.cycle_time_s
    return ResidualLimit(
        waist_depth_bin=2.0 * waist_m * _STEEPEST / waveform.range_bin_m,
        rayleigh_range_bin=pi * waist_m**2 / waveform.wavelength_m / waveform.range_bin_m,
        travel_per_bin=waveform.speed_bin_mps * looks * waveform.cycle_time_s / waveform.range_bin_m,
        constant_bin=1.0
        + 4.0 * waveform.linewidth_hz / waveform.bin_width_hz
        + 2.0 * change_mps / waveform.speed_bin_mps,
    )


@kernel
def largest_residual_bin(
    limit: ResidualLimit, range_bin: float, doppler_bin: float, residual_variance: float, width_bin2: float
) -> float:
    """Largest residual of one surface, in bins.

    Args:
        limit: constants of the instrument.
        range_bin, doppler_bin: measured beat of range and Doppler shift.
        residual_variance: variance of the residual.
        width_bin2: second moment of the widest of the three peaks; 0 where it is unknown.
    """
    depth = limit.waist_depth_bin * np.sqrt(1.0 + (range_bin / limit.rayleigh_range_bin) ** 2)
    if width_bin2 > 0.0:
        depth = min(depth, _WIDTHS * np.sqrt(width_bin2))
    travel = limit.travel_per_bin * abs(doppler_bin)
    return float(_DEVIATIONS * np.sqrt(residual_variance) + depth + travel + limit.constant_bin)


@kernel
def close_residual_bin(residual_variance: float) -> float:
    """Largest residual of targets that are not the strongest of each spectrum, in bins."""
    return float(_DEVIATIONS * np.sqrt(residual_variance) + _CLOSE_BIN)
