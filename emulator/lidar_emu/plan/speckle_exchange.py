"""Exchange of scatterers within a record as footprints slide over the ground."""

from __future__ import annotations

import numpy as np

from lidar_emu.fmcw.returns import Echoes
from lidar_emu.fmcw.speckle_change import LINE_BIN2
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scanner.wavefront import beam_radius_m
from lidar_emu.scenario.instrument import Instrument


def grown_beam_drift_per_s(instrument: Instrument, echoes: Echoes) -> FloatArray:
    """Drift of the speckle field (shots, beams, 2), for beams of several beamlets.

    Their Doppler shifts are their own: the exchange is slower by the growth of the beam.
    """
    waist_m = instrument.optics.waist_radius_m
    radius_m = beam_radius_m(echoes.range_m[..., 0], waist_m, instrument.waveform.wavelength_m)
    drift_per_s: FloatArray = echoes.speckle_drift_per_s * (waist_m / radius_m)[..., None]
    return drift_per_s


def exchange_bin2(instrument: Instrument, drift_per_s: FloatArray) -> FloatArray:
    """Variance in bins² of the line by the exchange of scatterers, for drifts (..., 2) in pitches per second."""
    return np.asarray(LINE_BIN2 * (drift_per_s**2).sum(axis=-1) * instrument.waveform.record_time_s**2)
