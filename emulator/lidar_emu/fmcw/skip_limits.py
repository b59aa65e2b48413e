"""Limits below which a stage of the receiver is left out, beam by beam."""

from __future__ import annotations

from lidar_emu.fmcw.peak_interpolation import noise_bin2, rounding_bin2
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.numerics.kernels import kernel

_SCATTERS = 3
"""Stages that are left out by their scatter: change of speckle within a record, laser line, beamlets."""


def allowed_variance_share(left_out_share: float) -> float:
    """Share of a beat's variance that each stage may leave out, so that sigma changes by `left_out_share` at most."""
    return ((1.0 + left_out_share) ** 2 - 1.0) / _SCATTERS


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

LEAST_SWEEP_SCATTER_BINS = 1e-3
"""Errors of the laser's sweep are left out where they scatter a beat by less: by 0.001 bin of range and speed."""

LEAST_RIPPLE = 2e-3
"""A periodic deviation of the sweep is left out where it modulates the beat's phase by less: side lines below 0.001 of
the line's amplitude, and a shift of its frequency below 0.002 bin."""

LEAST_LEAKAGE = 1e-4
LEAST_LEAKED_SNR = 1e-3
"""Leakage between beams is left out where the amplitude of the strongest echo's leakage is less relative to the
weakest echo, which it moves by less than 0.0001 bin, and its power in a bin less relative to the noise."""

LEAST_HAZE = 6.9
"""Bins of haze that exceed the threshold with a smaller probability than exp(-6.9), 1e-3, are not computed one by one:
only the highest of them are drawn, as targets without neighbours."""

LEAST_FALSE_ALARM = 1e-9
"""Noise peaks that matter with a smaller probability are not drawn."""
