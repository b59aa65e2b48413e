"""Estimation of the beat of range and the Doppler shift from three frequencies in bins, by exhaustive search."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import BoolArray, FloatArray

_REFUTED = 9.0
"""Three standard deviations, squared: cost of a fold at N/2, and additional cost at which an alternative is rejected.
"""

_APART = 36.0
"""Six standard deviations, squared: closer explanations count as equal."""

_SLACK = 3.0
"""Standard deviations by which the beat of range may lie outside the possible range."""

_DESIGN = np.array([[1.0, -1.0], [0.0, 1.0], [1.0, 1.0]])
"""Design matrix: signed beats of up-chirp, constant segment and down-chirp from range and Doppler shift."""

_CONSTRAINT = np.array([-1.0, -2.0, 1.0])
"""The combination of signed beats that is 0, orthogonal to the design."""


class Combined(NamedTuple):
    """Estimates (records,); NaN where no choice of signs and folds is possible."""

    range_bin: FloatArray
    doppler_bin: FloatArray
    range_variance: FloatArray
    doppler_variance: FloatArray
    residual_bin: FloatArray
    """Residual g₋ - g₊ - 2 g₀ with the chosen signs."""
    sign_resolved: BoolArray
    """Whether no alternative explanation has a comparable cost."""


def chirp_minus_doppler(observed: FloatArray, variance: FloatArray) -> Combined:
    """The published detector (Budge et al.): the higher chirp less the Doppler line; folds at N/2 are ignored.

    The lower chirp may have passed zero: in the residual it has the sign that fits better. The sign counts as resolved
    where the chirps differ by three standard deviations and the residual is within three standard deviations (and a
    bin).

    Args:
        observed: (records, 3) frequencies of up-chirp, constant segment, down-chirp.
        variance: variances of the frequencies.
    """
    up, constant, down = np.moveaxis(observed, -1, 0)
    up_variance, constant_variance, down_variance = np.moveaxis(variance, -1, 0)
    receding = up > down
    doppler = np.where(receding, -constant, constant)
    longer, shorter = np.where(receding, up, down), np.where(receding, down, up)
    excess = longer - 2.0 * constant
    fitting = np.where(abs(excess - shorter) <= abs(excess + shorter), excess - shorter, excess + shorter)
    residual = np.where(receding, -fitting, fitting)
    differ = np.square(up - down) > _REFUTED * (up_variance + down_variance)
    scatter = np.sqrt(_REFUTED * (variance @ np.square(_CONSTRAINT)))
    # Motion and the chirps' optical frequencies separate the segments' Doppler shifts by a fraction of a bin.
    consistent = np.abs(residual) <= scatter + 1.0
    return Combined(
        longer - constant,
        doppler,
        np.where(receding, up_variance, down_variance) + constant_variance,
        constant_variance,
        residual,
        differ & consistent,
    )


def least_squares(observed: FloatArray, variance: FloatArray, length: int, farthest_bin: float) -> Combined:
    """Weighted least squares with the signs and folds of least residual.

    A chirp is one of F, -F, N - F, F - N, the constant segment F or -F. The cost is the squared residual in standard
    deviations, plus 9 for each fold at N/2, and the beat of range must lie from 0 to `farthest_bin`, to three standard
    deviations. At equal cost a closing constant segment takes precedence, then the first up-chirp and the first
    down-chirp in the order F, -F, N - F, F - N. The sign is resolved where all others more than six standard deviations
    away in range or Doppler shift cost more by 9, or by 9 times the squared residual of the chosen one.

    Args:
        observed, variance: (records, 3).
        length: N.
        farthest_bin: largest possible beat of range.
    """
    weighted = _DESIGN[None] / variance[..., None]
    covariance = np.linalg.inv(np.swapaxes(weighted, 1, 2) @ _DESIGN)
    solver = covariance @ np.swapaxes(weighted, 1, 2)
    range_variance, doppler_variance = covariance[:, 0, 0], covariance[:, 1, 1]
    slack = _SLACK * np.sqrt(range_variance)
    spread = variance @ np.square(_CONSTRAINT)

    # Every choice of signs and folds: (32,), then (records, 32).
    chirp = ((1.0, 0.0), (-1.0, 0.0), (-1.0, 1.0), (1.0, -1.0))
    choices = np.array([(up, constant, down) for constant, up, down in product(chirp[:2], chirp, chirp)])
    signed = choices[:, :, 0] * observed[:, None] + choices[:, :, 1] * length
    # Summed explicitly: a library's sum may round mirrored choices differently, and equal costs would no longer be
    # equal.
    residual = signed[..., 2] - signed[..., 0] - 2.0 * signed[..., 1]
    cost = np.square(residual) / spread[:, None] + _REFUTED * np.abs(choices[:, :, 1]).sum(axis=1)
    beat, doppler = np.moveaxis(np.einsum("rbs,rcs->rcb", solver, signed), -1, 0)
    cost[(beat < -slack[:, None]) | (beat > farthest_bin + slack[:, None])] = np.inf

    row, best = np.arange(len(observed)), np.argmin(cost, axis=1)
    least = cost[row, best]
    found = np.isfinite(least)
    apart = np.square(beat - beat[row, best][:, None]) > _APART * range_variance[:, None]
    apart |= np.square(doppler - doppler[row, best][:, None]) > _APART * doppler_variance[:, None]
    limit = least + _REFUTED * np.maximum(1.0, np.square(residual[row, best]) / spread)
    rivalled = (apart & np.isfinite(cost) & (cost <= limit[:, None])).any(axis=1)
    return Combined(
        np.where(found, beat[row, best], np.nan),
        np.where(found, doppler[row, best], np.nan),
        range_variance,
        doppler_variance,
        np.where(found, residual[row, best], np.nan),
        found & ~rivalled,
    )
