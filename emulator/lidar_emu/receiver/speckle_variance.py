"""What the quadratures of three frequencies show of speckle, of one look and of several; see `stated_variance`."""

from __future__ import annotations

from math import pi, sqrt
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.receiver.range_speed_estimation import ALL

_Numbers = TypeVar("_Numbers", float, FloatArray)

NOISE_SHARE = 0.88
"""Factor of the variance by noise: the excess is never negative, and raises it by chance."""

LEAST_EXCESS, EXCESS_FACTOR = 1.25, 2.2
"""F from which the variances of the frequencies grow, and how much they grow by."""

_LEAST_COMMON, _COMMON_FACTOR, _COMMON_NOISE = 3.0, 3.0, 0.5
"""The error in common counts where a squared combination of the quadratures over its variance by noise is larger, as it
is by chance in one measurement of twelve. The factor applies to this ratio less the third constant."""

_CAUCHY_SIGMA2 = 3.37
"""Square of the 68.27 % quantile of Cauchy's law, which an error has relative to its quadrature alone."""

_LEAST_CHANGE, _STEADY_FACTOR = 1.25, 2.0
"""For several looks: F from which speckle counts as changing, less 1 and times the root of the looks; and factor of the
squared mean of the quadratures."""

_DRIFT_NOISE = 2.0
"""Squared change of the range's beat from look to look from which it counts, over its variance. What fades leave of the
looks determines it worse than all of them would."""

BENT_OFFSET = 2.58**2 / 12.0
"""Square of an offset's bias by a line of variance s², over s⁴: -2.58 s² δ by three bins of any window, δ anywhere in
the bin. It is the same in all looks."""

COMMON_LINE_BINS = 0.04
"""Width of a line whose error is common to the segments by half."""


class SpeckleParts(NamedTuple):
    """Parts of the variances by speckle, in bins²."""

    noise_share: float
    """Factor of the variances by noise."""
    excess: float
    """Variance by speckle of each frequency over its variance by noise."""
    doppler_bin2: float
    """Variance of an error common to the Doppler shifts."""
    chirps_bin2: float
    """Variance of each chirp's frequency by speckle that moves the range."""


@kernel
def one_look(
    mask: int, over_noise: float, mean_noise: float, targets: NDArray[Any], in_phase: float
) -> SpeckleParts:
    """The parts by one record of each segment.

    Args:
        mask, targets: see `state_variances`.
        over_noise: F, mean square of the quadratures over their variance by noise.
        mean_noise: harmonic mean of their variances by noise, in bins².
        in_phase: variance of a quadrature by the laser's line, in bins².
    """
    third = 1.0 / ((mask & 1) + (mask >> 1 & 1) + (mask >> 2))
    speed_weights = third * (mask & 1), third * (mask >> 1 & 1), third * (mask >> 2)
    square_bin2, noise_bin2 = combined_quadrature(speed_weights, targets, in_phase)
    common_bin2 = max(square_bin2 - noise_bin2, 0.0)
    curved_bin2 = depth_bin2 = without_depth = 0.0
    if mask == ALL:
        bend_bin2, bend_noise_bin2 = combined_quadrature((1.0, -2.0, 1.0), targets, in_phase)
        curved_bin2 = max(bend_bin2 - bend_noise_bin2, 0.0)
        without_depth = 0.5 * (square_bin2 / noise_bin2 + bend_bin2 / bend_noise_bin2)
        difference_bin2, difference_noise_bin2 = combined_quadrature((-0.5, 0.0, 0.5), targets, in_phase)
        depth_bin2 = max(difference_bin2 - difference_noise_bin2, 0.0)
    exchange_bin2 = 2.0 * (common_bin2 + curved_bin2 / 6.0)
    common = COMMON_LINE_BINS**2 / (COMMON_LINE_BINS**2 + exchange_bin2)
    # Where the records share their speckle, depth is in both chirps' quadratures.
    by_motion = over_noise - common * depth_bin2 / (1.5 * mean_noise)
    excess = EXCESS_FACTOR * (1.0 - common) * max(by_motion - LEAST_EXCESS, 0.0)
    doppler_bin2 = 0.0
    if square_bin2 >= _LEAST_COMMON * noise_bin2:
        doppler_bin2 = _CAUCHY_SIGMA2 * common_bin2
    if without_depth >= _LEAST_COMMON:
        doppler_bin2 = max(
            doppler_bin2, _COMMON_FACTOR * common * (without_depth - _COMMON_NOISE) * mean_noise
        )
    # Records of their own speckle show the mean's error in the excess of each.
    doppler_bin2 = max(doppler_bin2 - excess * noise_bin2, 0.0)
    return SpeckleParts(NOISE_SHARE, excess, doppler_bin2, 0.0)


@kernel
def several_looks(
    looks: float,
    segment_records: float,
    over_noise: float,
    steady: float,
    mean_noise: float,
    whole: bool,
    targets: NDArray[Any],
) -> SpeckleParts:
    """The parts by the records of several looks.

    The quadrature is half the rate of the power: over successive looks it adds up to the difference of two powers,
    while the error, the rate of the phase, adds up to many turns. Mean squares over the looks are alike, and
    errors are correlated as the power is (`record_correlation`).
    """
    certainty = 1.0 / sqrt(looks)
    exchange_bin2 = max(over_noise - 1.0, 0.0) * mean_noise
    decay = 8.0 * pi**2 * looks * exchange_bin2 * segment_records**2
    same, beside = record_correlation(looks, decay, 0.0), record_correlation(looks, decay, 1.0)
    apart = record_correlation(looks, decay, 2.0)
    excess = (same - apart) * max(over_noise - 1.0 - (LEAST_EXCESS - 1.0) * certainty, 0.0)
    excess += BENT_OFFSET * (2.0 * looks * exchange_bin2) ** 2 / mean_noise
    changes = over_noise > 1.0 + _LEAST_CHANGE * certainty
    doppler_bin2 = exchange_bin2 * (4.0 * beside + 5.0 * apart) / 9.0 if changes else 0.0
    if steady > _LEAST_COMMON:
        still_bin2 = _STEADY_FACTOR * apart / same * (steady / 3.0 - _COMMON_NOISE) * mean_noise
        doppler_bin2 = max(doppler_bin2, still_bin2)
    chirps_bin2 = 0.0
    if whole:
        up, constant, down = targets[0], targets[1], targets[2]
        if not changes:
            noise = up.quadrature_variance_bin2 + down.quadrature_variance_bin2
            square = (down.quadrature_bin - up.quadrature_bin) ** 2
            if square > _LEAST_COMMON * noise:
                chirps_bin2 = _STEADY_FACTOR * (square - _COMMON_NOISE * noise)
        # The lower chirp's beat has passed 0 where the sum of both is the Doppler shift's.
        rise, fall = up.frequency_bin + down.frequency_bin, abs(up.frequency_bin - down.frequency_bin)
        passed = abs(rise - 2.0 * constant.frequency_bin) < abs(fall - 2.0 * constant.frequency_bin)
        drift = 0.5 * (down.drift_bin - up.drift_bin if passed else down.drift_bin + up.drift_bin)
        drift_bin2 = drift**2 - _DRIFT_NOISE * 6.0 / (looks**2 - 1.0) * (1.0 + excess) * mean_noise
        wander = centre_wander(looks, decay, 0.0) + centre_wander(looks, decay, 2.0)
        if changes or steady > _LEAST_COMMON:
            chirps_bin2 += wander * max(drift_bin2, 0.0)
    return SpeckleParts(1.0 - (1.0 - NOISE_SHARE) * certainty, excess, doppler_bin2, chirps_bin2)


@kernel
def combined_quadrature(
    weights: tuple[float, float, float], targets: NDArray[Any], in_phase: float
) -> tuple[float, float]:
    """Square of a combination of the quadratures, and its variance by noise, in bins²."""
    total = noise_bin2 = 0.0
    for segment in range(3):
        if weights[segment] != 0.0:
            total += weights[segment] * targets[segment].quadrature_bin
            noise_bin2 += weights[segment] ** 2 * (targets[segment].quadrature_variance_bin2 + in_phase)
    return total * total, noise_bin2


@kernel
def record_correlation(looks: float, decay: _Numbers, segments: float) -> _Numbers:
    """Covariance of the means over looks of two segments' errors by speckle, times the looks, relative to the variance
    of one record's.

    In a circular Gaussian process with the correlation r(t) the rate of the phase, times the power, has the covariance
    (r'² - r r'')/2: for a Gaussian r it falls as r², the correlation of the power, here exp(-decay n²) over n segments.
    The rate of the power itself is anticorrelated instead, and its mean covariance is 0.

    Args:
        looks: number of looks M, three segments apart.
        decay: -ln of the power's correlation in neighbouring records; an array where interpreted.
        segments: distance between the two segments in a cycle.

    Returns:
        Σ (1 - |n|/M) exp(-decay (3n + segments)²) over -M < n < M.
    """
    total: _Numbers = 0.0 * decay
    for look in range(1 - int(looks), int(looks)):
        total = total + (1.0 - abs(look) / looks) * np.exp(-decay * (3.0 * look + segments) ** 2)
    return total


@kernel
def centre_wander(looks: float, decay: _Numbers, segments: float) -> _Numbers:
    """Covariance of the centres of power of two segments' looks, in looks²: what speckle weighs more counts more.

    To first order in the power's changes, ΣΣ exp(-decay (3(l - k) + segments)²) l k/M² with l and k from the middle of
    the looks; the sum of l (l + n) over the pairs n apart is m (m² - 1)/12 - m n²/4, m = M - |n|. Arguments as in
    `record_correlation`.
    """
    total: _Numbers = 0.0 * decay
    for look in range(1 - int(looks), int(looks)):
        pairs = looks - abs(look)
        products = pairs * (pairs * pairs - 1.0) / 12.0 - pairs * look * look / 4.0
        total = total + products / looks**2 * np.exp(-decay * (3.0 * look + segments) ** 2)
    return total
