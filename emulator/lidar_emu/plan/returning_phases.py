"""Beamlets whose phases return between the chirps of a measurement.

The beamlets lie on a triangular lattice and their Doppler shifts differ by motion across the beam. The correlation of
the up- and the down-chirp's echoes by these phases alone is the lattice's sum for a Gaussian footprint,

    Σ exp(-|u - b|²/16),    u = 2π (Doppler shift per radius w) (time between the chirps),

over the vectors b of the reciprocal lattice. The term b = 0 is the beam's own, the others are the lattice's: where they
count, both chirps have the same errors, which cancel in the range.
"""

from __future__ import annotations

from math import hypot, pi, sqrt
from typing import get_args

import numpy as np

from lidar_emu.echo.spectral_spread import Spread
from lidar_emu.fmcw.returns import Echoes
from lidar_emu.fmcw.speckle import PITCH_W
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.plan.speckle_exchange import exchange_bin2, grown_beam_drift_per_s
from lidar_emu.scanner.footprint import beamlet_pattern
from lidar_emu.scenario.instrument import Instrument, Optics

ALLOWED_SHARE = 0.1
"""Share of the variance of beats that may be common to both chirps: 5 % of sigma."""

_COUNTS: tuple[int, ...] = get_args(Optics.model_fields["beamlets"].annotation)

_SHELLS = np.sqrt([1.0, 3.0, 4.0, 7.0, 9.0, 12.0, 13.0, 16.0])
"""Lengths of the vectors of the reciprocal lattice over the least one."""


def common_share(
    instrument: Instrument, echoes: Echoes, spread: Spread, variance_bin2: FloatArray, beamlets: int
) -> float:
    """Largest share of the variance of a flight's beats that returning phases make common to both chirps.

    Args:
        instrument: instrument with speckle.
        echoes: echoes of one beamlet per beam, (shots, beams, 1).
        spread: of their footprints.
        variance_bin2: (shots, beams) of a beat, NaN without light.
        beamlets: beamlets per beam, at least 7.
    """
    waveform = instrument.waveform
    between_s = 2.0 * waveform.segment_time_s
    shift_hz = sqrt(8.0) * waveform.bin_width_hz * np.sqrt(spread.variance(0.0, 1.0))
    phases = lattice_correlation(2.0 * pi * between_s * shift_hz, beamlets)
    drift_per_s = grown_beam_drift_per_s(instrument, echoes)
    exchanged = np.exp(-2.0 * (PITCH_W * between_s) ** 2 * (drift_per_s**2).sum(axis=-1))
    by_speckle_bin2 = 0.5 * exchange_bin2(instrument, echoes.speckle_drift_per_s) / instrument.detection.looks
    share = phases**2 * exchanged * by_speckle_bin2 / variance_bin2
    return float(np.nanmax(share, initial=0.0))


def lattice_correlation(phase_per_w: FloatArray, beamlets: int) -> FloatArray:
    """Correlation that the lattice adds to a Gaussian footprint's, in the worst direction of the motion.

    Args:
        phase_per_w: phases per 1/e² radius of the footprint, in radians.
        beamlets: beamlets of the pattern, at least 7.
    """
    offset_w, _ = beamlet_pattern(beamlets)
    spacing_w = hypot(*offset_w[1])
    shells = 4.0 * pi / (sqrt(3.0) * spacing_w) * _SHELLS
    apart = np.abs(np.asarray(phase_per_w)[..., None] - shells).min(axis=-1)
    return np.asarray(np.exp(-(apart**2) / 16.0))


def enough_beamlets(instrument: Instrument, echoes: Echoes, spread: Spread, variance_bin2: FloatArray) -> int:
    """The instrument's beamlets, or the next larger pattern whose `common_share` is allowed; 127 at most."""
    asked = instrument.optics.beamlets
    for beamlets in (count for count in _COUNTS if count >= asked):
        if common_share(instrument, echoes, spread, variance_bin2, beamlets) <= ALLOWED_SHARE:
            return beamlets
    return _COUNTS[-1]
