"""Limits below which a stage of the receiver is left out, beam by beam."""

from __future__ import annotations

from lidar_emu.numerics.kernels import kernel
from lidar_emu.receiver.peak_interpolation import noise_bin2, rounding_bin2
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.scenario.instrument import Instrument


def allowed_variance_share(left_out_share: float, instrument: Instrument) -> float:
    """Share of a beat's variance that each stage may leave out, so that sigma changes by `left_out_share` at most.

    The stages that are left out by their scatter are change of speckle within a record, laser line and beamlets, and
    where the instrument has them errors of the sweep, its ripple and leakage between beams.
    """
    waveform = instrument.waveform
    has_sweep_errors = waveform.slope_scatter > 0.0 or waveform.flicker_hz2 > 0.0
    others = has_sweep_errors, waveform.ripple_hz > 0.0, instrument.optics.leakage_db is not None
    return ((1.0 + left_out_share) ** 2 - 1.0) / (3 + sum(others))


@kernel
def negligible_bin2(model: ReceiverModel, power_w: float) -> float:
    """Variance of a beat in bins² below which a stage is left out, for a beam of this power: a share of the variance by
    noise and quantisation."""
    noise = noise_bin2(model.peak_method, max(model.snr_per_w * power_w, 1e-30))
    return model.variance_share * (noise + rounding_bin2(model.peak_method))


LEAST_SMEAR_BINS = 0.05
"""A beat that changes by less during its record is not smeared: an error of 0.8 % of the line's amplitude beside it."""

LEAST_LINE_DRIFT = 0.01
"""The laser's linewidth is left out where its phase variance over the delay is smaller, 1 % of the echo's power, unless
its scatter matters."""

MOST_PULL_BINS = 0.7
"""Shift of a peak by a weak tone, relative to its amplitude, at most. A tone f bins away modulates the frequency by f
bins; an estimate is the mean of the frequency, whose weights pass the modulation by G(f)."""

LEAST_RIPPLE = 0.02
"""A periodic deviation of the sweep may be left out by its scatter where it modulates the beat's phase by less: side
lines of 0.01 of the line's amplitude, and 2e-4 of its power."""

LEAST_LEAKED_SNR = 0.1
"""Leakage between beams may be left out by its scatter where its power in a bin is less relative to the noise: it
exceeds the threshold no more often than five bins of noise do."""

LEAST_HAZE = 6.9
"""Bins of haze that exceed the threshold with a smaller probability than exp(-6.9), 1e-3, are not computed one by one:
only the highest of them are drawn, as targets without neighbours."""

LEAST_FALSE_ALARM = 1e-9
"""Noise peaks that matter with a smaller probability are not drawn."""
