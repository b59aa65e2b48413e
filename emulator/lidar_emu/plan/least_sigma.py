"""Least scatter of a flight's measurements: by noise, quantisation and speckle at the mean power of each beam."""

from __future__ import annotations

import numpy as np

from lidar_emu.fmcw.carrier_to_noise import snr_per_w
from lidar_emu.fmcw.peak_interpolation import PEAK_METHODS, noise_bin2, rounding_bin2
from lidar_emu.fmcw.range_speed_estimation import BEAT_WEIGHTS, COMBINE_METHODS
from lidar_emu.fmcw.returns import Echoes
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import interpreted
from lidar_emu.plan.speckle_exchange import exchange_bin2
from lidar_emu.scenario.instrument import Instrument
from lidar_emu.scenario.schema import FlightScenario


def beat_variance_bin2(scenario: FlightScenario, echoes: Echoes) -> FloatArray:
    """Variance of a beat in bins squared, (shots, beams), from echoes of one beamlet; NaN without light.

    Speckle that changes within a record makes a line of variance s², whose peak wanders by s²/2 at the mean power and
    by more in a fade. The laser's line and the slope of the ground add to the variance.
    """
    instrument = scenario.instrument
    method = PEAK_METHODS[instrument.detection.peak]
    power_w = np.where(echoes.power_w[..., 0] > 0.0, echoes.power_w[..., 0], np.nan)
    noise = interpreted(noise_bin2)(method, snr_per_w(instrument, scenario.site) * power_w)
    variance = noise + interpreted(rounding_bin2)(method)
    if instrument.optics.speckle:
        variance += 0.5 * exchange_bin2(instrument, echoes.speckle_drift_per_s)
    return np.asarray(variance / instrument.detection.looks)


def least_sigma(instrument: Instrument, variance_bin2: FloatArray) -> tuple[float, float]:
    """Least standard deviations of range in m and closing speed in m/s of beams whose beats have these variances; 0
    without light."""
    least = float(np.nanmin(variance_bin2, initial=np.inf))
    weights = BEAT_WEIGHTS[COMBINE_METHODS[instrument.detection.combine]]
    range_m, speed_mps = np.sqrt(least * (weights**2).sum(axis=-1).min(axis=0))
    if not np.isfinite(least):
        return 0.0, 0.0
    return float(range_m * instrument.waveform.range_bin_m), float(
        speed_mps * instrument.waveform.speed_bin_mps
    )
