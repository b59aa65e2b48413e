"""From the three observed frequencies to range and closing speed, all in bins.

The beats carry signs, g₊ = b - d, g₀ = d, g₋ = b + d with b the beat of range and d the Doppler shift; a
homodyne receiver shows only where each of them folds to between 0 and N/2. Estimators differ in how they find
the signs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lidar_emu.kernels import njit

_RESOLVED_COST = 9.0
"""A rival explanation that costs this much more, three standard deviations, is refuted."""

_FOLD_COST = 9.0
"""A fold at N/2 must be worth three standard deviations of the residual."""

_APART_VARIANCES = 36.0
"""Explanations nearer than six standard deviations tell the same."""


class Estimate(NamedTuple):
    """What one target's three frequencies say, in bins and bins²."""

    found: bool
    """Some choice of signs and folds lies within the instrument's range, to three standard deviations."""
    range_bin: float
    """b; slightly negative where noise alone made it so."""
    doppler_bin: float
    """d, positive when closing."""
    range_variance: float
    doppler_variance: float
    residual_bin: float
    """g₋ - g₊ - 2 g₀ with the chosen signs: 0 for three consistent frequencies."""
    sign_resolved: bool
    """No rival explanation comes near."""


@njit(cache=True)
def chirp_minus_doppler(
    up: float, constant: float, down: float, up_var: float, constant_var: float, down_var: float
) -> Estimate:
    """The published detector: range from the chirp that holds the sum, less the Doppler line.

    Budge et al.: the up-chirp above the down-chirp means receding. It knows nothing of folds at N/2. The sign
    counts as resolved when the chirps differ by more than three standard deviations of their difference and the
    residual stays within three of its own: a fold at N/2 shows there.

    Args:
        up, constant, down: observed frequencies F₊, F₀, F₋.
        up_var, constant_var, down_var: their variances.
    """
    closing = not up > down
    longer, shorter = (down, up) if closing else (up, down)
    # The shorter chirp's tone may have passed zero: its sign is the one that fits better.
    excess = longer - 2.0 * constant
    residual = excess - shorter if abs(excess - shorter) <= abs(excess + shorter) else excess + shorter
    apart = (down - up) ** 2 > _RESOLVED_COST * (up_var + down_var)
    consistent = residual**2 <= _RESOLVED_COST * (up_var + 4.0 * constant_var + down_var)
    return Estimate(
        True,
        longer - constant,
        constant if closing else -constant,
        (down_var if closing else up_var) + constant_var,
        constant_var,
        residual if closing else -residual,
        apart and consistent,
    )


@njit(cache=True)
def least_squares(
    up: float,
    constant: float,
    down: float,
    up_var: float,
    constant_var: float,
    down_var: float,
    length: float,
    farthest_bin: float,
) -> Estimate:
    """Joint least squares over the three segments, with the signs and folds that explain them best.

    A chirp's signed beat is F, -F, N - F or F - N. The constant segment's is F or -F: a Doppler shift beyond
    N/2 moves all three tones by N and looks in every way like its alias. An explanation puts the residual r =
    g₋ - g₊ - 2 g₀ to zero by corrections in proportion to the variances, and is admitted where b lies between
    0 and `farthest_bin`, give or take three standard deviations. It costs r² over its variance, plus 9 for
    each fold at N/2 that it assumes; of equals the closing one is taken. The sign counts as resolved when
    every admitted explanation that lies more than six standard deviations away in b or d costs more by 9, or
    by 9 times r² over its variance where the residual shows that the variances are too small.

    Args:
        up, constant, down: observed frequencies F₊, F₀, F₋.
        up_var, constant_var, down_var: their variances.
        length: N.
        farthest_bin: largest b that the instrument can have observed.
    """
    spread = up_var + 4.0 * constant_var + down_var
    range_var = 0.25 * (up_var + down_var - (up_var - down_var) ** 2 / spread)
    doppler_var = constant_var - 4.0 * constant_var**2 / spread
    slack = 3.0 * np.sqrt(range_var)
    range_share = 0.5 * (up_var - down_var) / spread
    doppler_share = 2.0 * constant_var / spread

    best_cost, best_range, best_doppler, best_residual = np.inf, np.nan, np.nan, np.nan
    rival_cost = np.inf
    for rivals in (False, True):
        for choice in range(32):
            g_constant = constant if choice < 16 else -constant
            g_up = _signed(up, (choice >> 2) & 3, length)
            g_down = _signed(down, choice & 3, length)
            residual = g_down - g_up - 2.0 * g_constant
            beat = 0.5 * (g_up + g_down) + range_share * residual
            if not -slack <= beat <= farthest_bin + slack:
                continue
            doppler = g_constant + doppler_share * residual
            folds = ((choice >> 3) & 1) + ((choice >> 1) & 1)
            cost = residual * residual / spread + _FOLD_COST * folds
            if not rivals:
                if cost < best_cost:
                    best_cost, best_range, best_doppler, best_residual = cost, beat, doppler, residual
            elif (beat - best_range) ** 2 > _APART_VARIANCES * range_var or (
                doppler - best_doppler
            ) ** 2 > _APART_VARIANCES * doppler_var:
                rival_cost = min(rival_cost, cost)
    return Estimate(
        best_cost < np.inf,
        best_range,
        best_doppler,
        range_var,
        doppler_var,
        best_residual,
        rival_cost > best_cost + _RESOLVED_COST * max(1.0, best_residual**2 / spread),
    )


@njit(cache=True)
def _signed(observed: float, choice: int, length: float) -> float:
    """The signed beat behind an observed frequency: F, -F, N - F, F - N."""
    unfolded = observed if choice < 2 else length - observed
    return unfolded if choice % 2 == 0 else -unfolded
