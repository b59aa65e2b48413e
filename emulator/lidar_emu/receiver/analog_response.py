"""Response of amplifier and digitiser to tones and noise: poles, aliased noise, clipping."""

from __future__ import annotations

from math import erf, erfc, exp, pi, sqrt
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import SingleArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import FAST, sin_pi
from lidar_emu.receiver.spectrum import BIN, NOISE


class Response(NamedTuple):
    """The analog chain; noise powers are fractions of the white noise of an ideal receiver's rectangular bin."""

    lowpass_bin: float
    """Half-power frequency of the amplifier in bins; infinite if it is flat."""
    highpass_bin: float
    """Half-power frequency of the AC coupling in bins; 0 without AC coupling."""
    fold_scale: float
    fold_decay: float
    """(πc/N) (1 - q²) and q, with q = exp(-2πc/N), c the amplifier's half-power frequency."""
    amplifier_noise: float
    """Fraction of the noise that the poles shape; with `digitiser_noise` it sums to 1."""
    digitiser_noise: float
    """Fraction of the noise that arises after the poles."""
    mean_noise: float
    """Mean over all bins of the noise behind poles and digitiser."""
    full_scale: float
    """Largest amplitude that is not clipped, relative to a tone's amplitude in its bin; infinite for an ideal
    digitiser."""


@kernel
def is_flat(response: Response) -> bool:
    """Whether the response has no poles."""
    return response.highpass_bin == 0.0 and response.lowpass_bin == np.inf


@kernel(fastmath=FAST)
def tone_gain(response: Response, signed_bin: float) -> tuple[float, float]:
    """Complex gain at a signed frequency before folding: the gain at -f is the conjugate."""
    gain_re, gain_im = 1.0, 0.0
    if response.highpass_bin > 0.0:
        below = response.highpass_bin * response.highpass_bin + signed_bin * signed_bin
        gain_re = signed_bin * signed_bin / below
        gain_im = signed_bin * response.highpass_bin / below
    x = signed_bin / response.lowpass_bin
    scale = 1.0 / (1.0 + x * x)
    return scale * (gain_re + x * gain_im), scale * (gain_im - x * gain_re)


@kernel(fastmath=FAST)
def set_noise(
    response: Response,
    length: float,
    power_gain: float,
    factor: float,
    added: float,
    grid: SingleArray,
    count: int,
) -> None:
    """Set NOISE of the first `count` bins to their mean noise power; see `noise_level`."""
    if is_flat(response):
        white = power_gain * factor * response.amplifier_noise + response.digitiser_noise + added
        noise = grid[NOISE]
        for j in range(count):
            noise[j] = np.float32(white)
        return
    number, noise, per_length = grid[BIN], grid[NOISE], 1.0 / length
    for j in range(count):
        k = np.float64(number[j])
        noise[j] = np.float32(noise_level(response, power_gain, factor, added, k, sin_pi(k * per_length)))


@kernel(fastmath=FAST)
def noise_level(
    response: Response, power_gain: float, factor: float, added: float, k: float, sine: float
) -> float:
    """Mean noise power of a rectangular bin.

    Noise from beyond N/2 is aliased as tones are. For a single pole at c the sum over all Nyquist zones has the closed
    form (πc/N) sinh(2πc/N) / (cosh(2πc/N) - cos(2πk/N)), evaluated here in powers of exp(-2πc/N); the AC coupling
    matters in the zone at 0 only.

    Args:
        response: response of the receiver.
        power_gain: gain of all power ahead of the digitiser, see `clipping`.
        factor: amplifier noise relative to its value without an echo.
        added: additional white noise, from clipping.
        k: index of the bin.
        sine: sine of πk/N.
    """
    level, zone = 1.0, 1.0
    if response.lowpass_bin < np.inf:
        apart = 1.0 - response.fold_decay
        level = response.fold_scale / (apart * apart + 4.0 * response.fold_decay * sine * sine)
        zone = 1.0 / (1.0 + (k / response.lowpass_bin) ** 2)
    if response.highpass_bin > 0.0:
        corner = response.highpass_bin * response.highpass_bin
        level -= zone * corner / (corner + k * k)
    ahead = factor * response.amplifier_noise * max(level, 0.0)
    return power_gain * ahead + response.digitiser_noise + added


@kernel
def unclipped_noise(response: Response, gain: float, distortion: float, noise: float) -> float:
    """Mean noise power of a bin if the digitiser did not clip, from its power with the results of `clipping`."""
    return (noise - response.digitiser_noise - distortion) / (gain * gain) + response.digitiser_noise


_UNCLIPPED = 7.0
"""Full scale over the standard deviation from which nothing is clipped."""

_LARGEST_FADE = 20.0
"""Power of an echo over its mean which speckle exceeds with a probability of 2e-9."""


@kernel
def may_clip(response: Response, length: float, power: float) -> bool:
    """Whether the digitiser clips with a probability above 2e-9, for tones of this mean sum of squares."""
    if response.full_scale == np.inf:
        return False
    variance = response.mean_noise * length / 4.0 + 0.5 * _LARGEST_FADE * power
    return bool(response.full_scale < _UNCLIPPED * sqrt(variance))


@kernel
def clipping(
    response: Response, tones: SingleArray, columns: int, length: float, others_power: float
) -> tuple[float, float]:
    """Gain and distortion of a clipping digitiser, for tones (4, tones), others of a sum of squares `others_power`, and
    noise that are treated as Gaussian (Bussgang's theorem). A steady tone alone keeps up to 2/√π times this gain.

    Returns:
        Gain, and power of the distortion per rectangular bin, treated as white.
    """
    variance = response.mean_noise * length / 4.0 + 0.5 * others_power
    for i in range(columns):
        variance += 0.5 * (np.float64(tones[2, i]) ** 2 + np.float64(tones[3, i]) ** 2)
    if not response.full_scale < _UNCLIPPED * sqrt(variance):
        return 1.0, 0.0
    limit = response.full_scale / sqrt(variance)
    gain = erf(limit / sqrt(2.0))
    kept = gain - sqrt(2.0 / pi) * limit * exp(-0.5 * limit * limit) + limit * limit * erfc(limit / sqrt(2.0))
    return gain, max(0.0, kept - gain * gain) * variance * 4.0 / length
