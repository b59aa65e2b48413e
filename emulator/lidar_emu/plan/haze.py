"""Probability that a beam locks on haze in place of the surface behind it, in closed form.

In a chirp the surface's echo fades, so that the power of its bin is exponential around its mean m; the bins of the haze
before it are exponential around theirs, and none of them exceeds p with the probability F(p). The highest bin is one of
the haze's, above the threshold T, with the probability

    ∫ from T of (1 - exp(-p/m)) dF(p).

Noise adds to both means.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from lidar_emu.fmcw.haze import haze_snr
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.returns import Echoes
from lidar_emu.fmcw.spectrum import SpectralWindow
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import interpreted
from lidar_emu.plan.detection_forecast import mean_straddling_gain

_PARTS, _POWERS = 64, 400
_BEAMS = 64
"""Beams of the sample for which the probability is computed."""


def haze_lock_probability(model: ReceiverModel, range_m: FloatArray, snr: FloatArray) -> FloatArray:
    """Probability (beams,) that haze is the highest target of a chirp, with one look and a flat receiver.

    Args:
        model: constants of the receiver.
        range_m, snr: (beams,) range of the surface, and its mean power in its bin.
    """
    growth = np.log1p(
        20.0 * range_m * (2.0 * model.haze.extinction_per_m + 1.0 / model.haze.rayleigh_range_m)
    )
    place = (np.arange(_PARTS) + 0.5) / _PARTS
    rise_m = range_m / np.expm1(growth)
    r = rise_m[:, None] * np.expm1(growth[:, None] * place)
    bins = (r + rise_m[:, None]) * growth[:, None] / _PARTS * model.beat_bin_per_m * model.independent_share
    spread = 1.0 + np.square(r / model.haze.rayleigh_range_m)
    density = model.haze.snr_per_m / model.beat_bin_per_m * np.exp(-2.0 * model.haze.extinction_per_m * r)
    mean = 1.0 + density / spread
    highest = mean.max(axis=1) * (30.0 + np.log(bins.sum(axis=1)))
    power = model.threshold + np.linspace(0.0, 1.0, _POWERS) * highest[:, None]
    below = np.exp(np.sum(bins[..., None] * np.log1p(-np.exp(-power[:, None, :] / mean[..., None])), axis=1))
    middle = 0.5 * (power[:, 1:] + power[:, :-1])
    stronger = -np.expm1(-middle / (1.0 + snr[:, None]))
    return np.asarray(np.sum(np.diff(below, axis=1) * stronger, axis=1))


def largest_haze_locks(model: ReceiverModel, echoes: Echoes) -> tuple[float, float]:
    """Largest probabilities that haze is the highest target of a chirp and of the constant segment.

    In the constant segment it is one line of exponential power, on the surface's own unless wind parts them.

    Args:
        model: constants of the receiver.
        echoes: sampled along a flight, with one beamlet per beam.
    """
    window = SpectralWindow(model.window_centre, model.window_side)
    lit = (echoes.range_m[..., 0] > 0.0) & (echoes.range_m[..., 0] < model.record_edge_range_m)
    if not lit.any():
        return 0.0, 0.0
    chosen = np.unique(np.linspace(0, np.count_nonzero(lit) - 1, _BEAMS).astype(int))
    range_m, power_w = echoes.range_m[..., 0][lit][chosen], echoes.power_w[..., 0][lit][chosen]
    snr = power_w * model.snr_per_w * mean_straddling_gain(window)
    chirp = float(haze_lock_probability(model, range_m, snr).max())
    line = np.vectorize(partial(interpreted(haze_snr), model), otypes=[float])(range_m)
    apart = np.abs(echoes.air_speed_mps - echoes.closing_speed_mps[..., 0])[lit][chosen] > model.speed_bin_mps
    return chirp, float(np.max(np.where(apart, line / (line + power_w * model.snr_per_w), 0.0)))
