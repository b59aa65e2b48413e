"""Estimation of range and closing speed from the three observed frequencies, all in bins.

The beats carry signs, g₊ = b - d, g₀ = d, g₋ = b + d with b the beat of range and d the Doppler shift; a
homodyne receiver shows only where each of them folds to between 0 and N/2. Estimators differ in how they find
the signs.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.kernels import kernel

UP, CONSTANT, DOWN = 1, 2, 4
"""Bits of a mask of segments."""
ALL = UP | CONSTANT | DOWN

CHIRP_MINUS_DOPPLER, LEAST_SQUARES = range(2)
COMBINE_METHODS = {"chirp_minus_doppler": CHIRP_MINUS_DOPPLER, "least_squares": LEAST_SQUARES}
"""Methods by their names in a scenario."""

_LEAST_SQUARES_WEIGHTS = (0.5, 0.0, 0.5), (-1 / 3, 1 / 3, 1 / 3)

BEAT_WEIGHTS = np.array(
    [
        [((0.0, -1.0, 1.0), (0.0, 1.0, 0.0)), ((1.0, 1.0, 0.0), (0.0, 1.0, 0.0))],
        [_LEAST_SQUARES_WEIGHTS, _LEAST_SQUARES_WEIGHTS],
    ]
)
"""(methods, 2, 2, 3) weights of g₊, g₀ and g₋, closing and receding, in b and d: each method's result where the signs
are known and the variances alike."""

_RESOLVED_COST = 9.0
"""A rival explanation that costs this much more, three standard deviations, is refuted."""

_FOLD_COST = 9.0
"""A fold at N/2 must be worth three standard deviations of the residual."""

_APART_VARIANCES = 36.0
"""Explanations nearer than six standard deviations tell the same."""

_AC_COUPLED_BINS = 16.0
"""A tone so near 0 may have been lost to AC coupling: 73 kHz with the default instrument."""

_ROUNDING = 1.0 + 1e-9


class Estimate(NamedTuple):
    """Range and Doppler shift of one target, in bins and bins²."""

    found: bool
    """Some choice of signs and folds lies within the instrument's range, to three standard deviations."""
    range_bin: float
    """b; slightly negative where noise alone made it so."""
    doppler_bin: float
    """d, positive when closing."""
    range_variance: float
    doppler_variance: float
    residual_bin: float
    """g₋ - g₊ - 2 g₀ with the chosen signs: 0 for three consistent frequencies, NaN for two."""
    sign_resolved: bool
    """No rival explanation comes near."""


@kernel
def estimate_range_speed(
    method: int, mask: int, targets: NDArray[Any], length: float, farthest_bin: float
) -> Estimate:
    """The estimate by one of COMBINE_METHODS; the other arguments are those of `least_squares`."""
    if method == CHIRP_MINUS_DOPPLER:
        return chirp_minus_doppler(targets)
    return least_squares(mask, targets, length, farthest_bin)


@kernel
def chirp_minus_doppler(targets: NDArray[Any]) -> Estimate:
    """The published detector: range from the chirp that holds the sum, less the Doppler line.

    Budge et al.: the up-chirp above the down-chirp means receding. Folds at N/2 are ignored. The sign
    counts as resolved when the chirps differ by more than three standard deviations of their difference and the
    residual stays within three of its own: a fold at N/2 shows there.

    Args:
        targets: (3,) of TARGET: one of each segment.
    """
    up, constant, down = targets[0].frequency_bin, targets[1].frequency_bin, targets[2].frequency_bin
    up_var, constant_var, down_var = (
        targets[0].variance_bin2,
        targets[1].variance_bin2,
        targets[2].variance_bin2,
    )
    closing = not up > down
    longer, shorter = (down, up) if closing else (up, down)
    # The shorter chirp's tone may have passed zero: its sign is the one that fits better.
    excess = longer - 2.0 * constant
    residual = excess - shorter if abs(excess - shorter) <= abs(excess + shorter) else excess + shorter
    apart = (down - up) ** 2 > _RESOLVED_COST * (up_var + down_var)
    scatter = np.sqrt(_RESOLVED_COST * (up_var + 4.0 * constant_var + down_var))
    # Motion and the chirps' optical frequencies set the segments apart by a part of a bin.
    consistent = abs(residual) <= scatter + 1.0
    return Estimate(
        True,
        longer - constant,
        constant if closing else -constant,
        (down_var if closing else up_var) + constant_var,
        constant_var,
        residual if closing else -residual,
        apart and consistent,
    )


@kernel
def least_squares(mask: int, targets: NDArray[Any], length: float, farthest_bin: float) -> Estimate:
    """Joint least squares over the segments that hold a target, with the signs and folds that explain them best.

    A chirp's signed beat is F, -F, N - F or F - N. The constant segment's is F or -F: a Doppler shift beyond
    N/2 moves all three tones by N and looks in every way like its alias.

    Of all three, an explanation puts the residual r = g₋ - g₊ - 2 g₀ to zero by corrections in proportion to the
    variances, and is admitted where b lies between 0 and `farthest_bin`, give or take three standard deviations.
    It costs r² over its variance, plus 9 for each fold at N/2 that it assumes. Of equals one with g₀ closing is taken,
    and of those the first with g₊, then g₋, in the order above.

    The sign counts as resolved when every admitted explanation that lies more than six standard deviations away in b or
    d costs more by 9, or by 9 times r² over its variance where the residual shows that the variances are too small.

    Two have no residual, and seldom a single explanation; see `_from_two`.

    Args:
        mask: bits of the segments that have a target: UP, CONSTANT, DOWN. The others' are ignored.
        targets: (3,) of TARGET: one of each segment, with its observed frequency F₊, F₀ or F₋.
        length: N.
        farthest_bin: largest b that the instrument can have observed.

    Returns:
        The estimate, not found where fewer than two segments are there or none of the explanations is admitted.
    """
    if mask == ALL:
        return _from_three(targets, length, farthest_bin)
    up, constant, down = targets[0].frequency_bin, targets[1].frequency_bin, targets[2].frequency_bin
    up_var, constant_var, down_var = (
        targets[0].variance_bin2,
        targets[1].variance_bin2,
        targets[2].variance_bin2,
    )
    if mask == UP | DOWN:
        variance = 0.25 * (up_var + down_var)
        return _from_two(mask, up, down, variance, variance, length, farthest_bin)
    if mask == UP | CONSTANT:
        return _from_two(mask, up, constant, up_var + constant_var, constant_var, length, farthest_bin)
    if mask == CONSTANT | DOWN:
        return _from_two(mask, down, constant, down_var + constant_var, constant_var, length, farthest_bin)
    return Estimate(False, np.nan, np.nan, np.nan, np.nan, np.nan, False)


@kernel
def _from_three(targets: NDArray[Any], length: float, farthest_bin: float) -> Estimate:
    up, constant, down = targets[0].frequency_bin, targets[1].frequency_bin, targets[2].frequency_bin
    up_var, constant_var, down_var = (
        targets[0].variance_bin2,
        targets[1].variance_bin2,
        targets[2].variance_bin2,
    )
    spread = up_var + 4.0 * constant_var + down_var
    if not spread < np.inf:
        return Estimate(False, np.nan, np.nan, np.nan, np.nan, np.nan, False)
    range_var = 0.25 * (up_var + down_var - (up_var - down_var) ** 2 / spread)
    doppler_var = constant_var - 4.0 * constant_var**2 / spread
    slack = 3.0 * np.sqrt(range_var)
    range_share = 0.5 * (up_var - down_var) / spread
    doppler_share = 2.0 * constant_var / spread

    best_cost, best_range, best_doppler, best_residual = np.inf, np.nan, np.nan, np.nan
    limit = np.inf
    rivalled = False
    for rivals in (False, True):
        if rivals:
            limit = best_cost + _RESOLVED_COST * max(1.0, best_residual**2 / spread)
        for g_constant in (constant, -constant):
            for i in range(4):
                g_up = _signed(up, i, length)
                for j in range(4):
                    g_down = _signed(down, j, length)
                    residual = g_down - g_up - 2.0 * g_constant
                    folding_cost = _FOLD_COST * ((i >> 1) + (j >> 1))
                    # Most are far too dear, which shows without a division.
                    if residual * residual > (limit - folding_cost) * spread * _ROUNDING:
                        continue
                    cost = residual * residual / spread + folding_cost
                    beat = 0.5 * (g_up + g_down) + range_share * residual
                    if not (cost <= limit and -slack <= beat <= farthest_bin + slack):
                        continue
                    doppler = g_constant + doppler_share * residual
                    if rivals:
                        rivalled |= (beat - best_range) ** 2 > _APART_VARIANCES * range_var or (
                            doppler - best_doppler
                        ) ** 2 > _APART_VARIANCES * doppler_var
                    elif cost < best_cost:
                        best_cost, best_range, best_doppler, best_residual = cost, beat, doppler, residual
                        limit = cost
    found = best_cost < np.inf
    return Estimate(
        found, best_range, best_doppler, range_var, doppler_var, best_residual, found and not rivalled
    )


@kernel
def _from_two(
    mask: int,
    chirp: float,
    other: float,
    range_var: float,
    doppler_var: float,
    length: float,
    farthest_bin: float,
) -> Estimate:
    """A chirp and either the other chirp or the constant segment.

    Explanations are admitted where 0 <= b <= `farthest_bin`, give or take three standard deviations, and |d| <=
    N/2. Of those with the fewest folds at N/2 the choice falls on

    1. one that is closing;
    2. one that explains why the third segment has no target: its tone would lie within _AC_COUPLED_BINS of 0, where AC
       coupling takes it. Two chirps without Doppler line are thus a hovering lidar if their tones lie close together;
    3. one with |d| > b, the state of nearly all of a landing: time to touchdown is then less than λS/c (97 s for a
       chirp of 2 MHz/µs at 1.55 µm), and what silenced the third segment is a fade.

    That is a choice of the likelier: the sign counts as resolved only where no other explanation is admitted, of
    any number of folds, that lies more than six standard deviations away.
    """
    slack = 3.0 * np.sqrt(range_var) if range_var < np.inf else np.nan
    best_cost, best_range, best_doppler = np.inf, np.nan, np.nan
    rivalled = False
    for rivals in (False, True):
        for choice in range(16):
            if mask != UP | DOWN and choice & 2:
                continue  # a fold of the Doppler line
            g_chirp = _signed(chirp, (choice >> 2) & 3, length)
            g_other = _signed(other, choice & 3, length)
            if mask == UP | DOWN:
                beat, doppler = 0.5 * (g_other + g_chirp), 0.5 * (g_other - g_chirp)
                silent = doppler
            elif mask == UP | CONSTANT:
                beat, doppler = g_chirp + g_other, g_other
                silent = beat + doppler
            else:
                beat, doppler = g_chirp - g_other, g_other
                silent = beat - doppler
            if not (-slack <= beat <= farthest_bin + slack and abs(doppler) <= 0.5 * length):
                continue
            if rivals:
                rivalled |= (beat - best_range) ** 2 > _APART_VARIANCES * range_var or (
                    doppler - best_doppler
                ) ** 2 > _APART_VARIANCES * doppler_var
                continue
            folds = ((choice >> 3) & 1) + ((choice >> 1) & 1)
            cost = 8.0 * folds
            cost += 4.0 if doppler < 0.0 else 0.0
            cost += 2.0 if abs(silent) > _AC_COUPLED_BINS else 0.0
            cost += 1.0 if abs(doppler) <= beat else 0.0
            if cost < best_cost:
                best_cost, best_range, best_doppler = cost, beat, doppler
    found = best_cost < np.inf
    return Estimate(found, best_range, best_doppler, range_var, doppler_var, np.nan, found and not rivalled)


@kernel
def _signed(observed: float, choice: int, length: float) -> float:
    """The signed beat behind an observed frequency: F, -F, N - F, F - N."""
    unfolded = observed if choice < 2 else length - observed
    return unfolded if choice % 2 == 0 else -unfolded
