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
    residual_variance: FloatArray
    sign_resolved: BoolArray
    """Whether no other explanation fits as well."""


def chirp_minus_doppler(
    observed: FloatArray, variance: FloatArray, length: int, farthest_bin: float
) -> Combined:
    """The published detector (Budge et al.): the higher chirp less the Doppler line; folds at N/2 are ignored.

    The lower chirp may have passed zero: in the residual it has the sign that fits better. The sign counts as resolved
    where the chirps differ by three standard deviations, the residual is within three standard deviations (and a bin),
    and there is no rival (`_explanations`).

    Args:
        observed: (records, 3) frequencies of up-chirp, constant segment, down-chirp.
        variance: variances of the frequencies.
        length: N.
        farthest_bin: largest possible beat of range.
    """
    up, constant, down = np.moveaxis(observed, -1, 0)
    up_variance, constant_variance, down_variance = np.moveaxis(variance, -1, 0)
    receding = up > down
    doppler = np.where(receding, -constant, constant)
    longer, shorter = np.where(receding, up, down), np.where(receding, down, up)
    excess = longer - 2.0 * constant
    shorter = np.where(abs(excess - shorter) <= abs(excess + shorter), shorter, -shorter)
    signed = np.stack(
        [np.where(receding, longer, shorter), doppler, np.where(receding, shorter, longer)], axis=-1
    )
    residual = signed @ _CONSTRAINT
    differ = np.square(up - down) > _REFUTED * (up_variance + down_variance)
    spread = variance @ np.square(_CONSTRAINT)
    # Motion and the chirps' optical frequencies separate the segments' Doppler shifts by a fraction of a bin.
    consistent = np.abs(residual) <= np.sqrt(_REFUTED * spread) + 1.0
    rivalled = _explanations(observed, variance, length, farthest_bin).rival_of(signed)
    return Combined(
        longer - constant,
        doppler,
        np.where(receding, up_variance, down_variance) + constant_variance,
        constant_variance,
        residual,
        spread,
        differ & consistent & ~rivalled,
    )


class _Explanations(NamedTuple):
    """All choices of signs and folds, (records, choices), by weighted least squares."""

    signed: FloatArray
    """(records, choices, 3)"""
    beat: FloatArray
    doppler: FloatArray
    misfit: FloatArray
    """Squared residual in standard deviations; infinite where the beat of range is impossible."""
    folds: FloatArray
    """(choices,) Number of folds."""
    range_variance: FloatArray
    """(records,)"""
    doppler_variance: FloatArray
    spread: FloatArray
    """(records,) Variance of the residual."""
    nearest_alias: FloatArray
    """(records,) Smallest beat b whose alias N - b is possible; with the opposite Doppler shift it has the same
    frequencies."""

    solver: FloatArray
    """(records, 2, 3) Beat of range and Doppler shift from signed beats."""

    def rival_of(self, signed: FloatArray) -> BoolArray:
        """Whether an explanation more than six standard deviations away from the one with these signed beats
        (records, 3), in range or Doppler shift, has a misfit that is larger by no more than 9, or 9 times its own;
        folds do not count, (records,)."""
        beat, doppler = np.einsum("rbs,rs->br", self.solver, signed)
        misfit = np.square(signed @ _CONSTRAINT) / self.spread
        apart = np.square(self.beat - beat[:, None]) > _APART * self.range_variance[:, None]
        apart |= np.square(self.doppler - doppler[:, None]) > _APART * self.doppler_variance[:, None]
        limit = misfit + _REFUTED * np.maximum(1.0, misfit)
        near = np.isfinite(self.misfit) & (self.misfit <= limit[:, None])
        return np.asarray((apart & near).any(axis=1) | (beat >= self.nearest_alias))


def _explanations(
    observed: FloatArray, variance: FloatArray, length: int, farthest_bin: float
) -> _Explanations:
    """Explanations of frequencies (records, 3).

    A chirp is one of F, -F, N - F, F - N, and N + F where beats beyond N/2 are possible; the constant segment F or -F.
    """
    weighted = _DESIGN[None] / variance[..., None]
    covariance = np.linalg.inv(np.swapaxes(weighted, 1, 2) @ _DESIGN)
    solver = covariance @ np.swapaxes(weighted, 1, 2)
    range_variance, doppler_variance = covariance[:, 0, 0], covariance[:, 1, 1]
    slack = _SLACK * np.sqrt(range_variance)
    spread = variance @ np.square(_CONSTRAINT)

    # Sign, multiple of N and folds: (choices, 3, 3), then (records, choices).
    chirp = [(1, 0, 0), (-1, 0, 0), (-1, 1, 1), (1, -1, 1)]
    if farthest_bin > length / 2:
        chirp.append((1, 1, 2))
    choices = np.array(
        [(up, constant, down) for constant, up, down in product(chirp[:2], chirp, chirp)], float
    )
    signed = choices[:, :, 0] * observed[:, None] + choices[:, :, 1] * length
    # Summed explicitly: a library's sum may round mirrored choices differently, and equal costs would no longer be
    # equal.
    residual = signed[..., 2] - signed[..., 0] - 2.0 * signed[..., 1]
    misfit = np.square(residual) / spread[:, None]
    beat, doppler = np.moveaxis(np.einsum("rbs,rcs->rcb", solver, signed), -1, 0)
    misfit[(beat < -slack[:, None]) | (beat > farthest_bin + slack[:, None])] = np.inf
    folds = choices[:, :, 2].sum(axis=1)
    alias = length - (farthest_bin + slack)
    return _Explanations(
        signed, beat, doppler, misfit, folds, range_variance, doppler_variance, spread, alias, solver
    )


def least_squares(observed: FloatArray, variance: FloatArray, length: int, farthest_bin: float) -> Combined:
    """Weighted least squares with the signs and folds of least residual.

    The cost of an explanation is the squared residual in standard deviations, plus 9 for each fold at N/2, and the beat
    of range must lie from 0 to `farthest_bin`, to three standard deviations. At equal cost a closing constant segment
    takes precedence, then the first up-chirp and the first down-chirp in the order F, -F, N - F, F - N, N + F. The sign
    is resolved where there is no rival.

    Args:
        observed, variance: (records, 3).
        length: N.
        farthest_bin: largest possible beat of range.
    """
    every = _explanations(observed, variance, length, farthest_bin)
    cost = every.misfit + _REFUTED * every.folds
    row, best = np.arange(len(observed)), np.argmin(cost, axis=1)
    found = np.isfinite(cost[row, best])
    signed = np.where(found[:, None], every.signed[row, best], np.nan)
    beat, doppler = (np.where(found, values[row, best], np.nan) for values in (every.beat, every.doppler))
    return Combined(
        beat,
        doppler,
        every.range_variance,
        every.doppler_variance,
        signed @ _CONSTRAINT,
        every.spread,
        found & ~every.rival_of(signed),
    )
