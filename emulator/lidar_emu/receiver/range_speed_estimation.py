"""Estimation of range and closing speed from the three observed beat frequencies, all in bins.

The beats have signs: g₊ = b - d, g₀ = d, g₋ = b + d, with the beat b of range and the Doppler shift d. A homodyne
receiver observes each of them folded to the range from 0 to N/2. Estimators differ in how they determine the signs.
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
"""Additional cost by which an alternative explanation is rejected: three standard deviations, squared."""

_FOLD_COST = 9.0
"""Cost of a fold at N/2: three standard deviations of the residual, squared."""

_APART_VARIANCES = 36.0
"""Explanations closer than six standard deviations, squared, count as equal."""

_AC_COUPLED_BINS = 16.0
"""A tone this close to 0 may have been lost to AC coupling: 73 kHz with the default instrument."""

_ROUNDING = 1.0 + 1e-9


class Estimate(NamedTuple):
    """Range and Doppler shift of one target, in bins and bins²."""

    found: bool
    """Whether a choice of signs and folds lies within the instrument's range, to three standard deviations."""
    range_bin: float
    """Beat of range b; may be slightly negative by noise."""
    doppler_bin: float
    """Doppler shift d, positive when closing."""
    range_variance: float
    doppler_variance: float
    residual_bin: float
    """Residual g₋ - g₊ - 2 g₀ with the chosen signs: 0 for three consistent frequencies, NaN for two."""
    residual_variance: float
    """Variance of the residual by the variances of the frequencies."""
    sign_resolved: bool
    """Whether no other explanation fits the frequencies as well; see `least_squares`."""
    folds: int
    """Chirps whose beat is folded at N/2."""


@kernel
def estimate_range_speed(
    method: int, mask: int, targets: NDArray[Any], length: float, farthest_bin: float
) -> Estimate:
    """Estimate by one of COMBINE_METHODS; see `least_squares` for the other arguments."""
    if method == CHIRP_MINUS_DOPPLER:
        return chirp_minus_doppler(targets, length, farthest_bin)
    return least_squares(mask, targets, length, farthest_bin)


@kernel
def chirp_minus_doppler(targets: NDArray[Any], length: float, farthest_bin: float) -> Estimate:
    """The published detector: range from the chirp with the higher beat, less the Doppler line.

    Budge et al.: if the up-chirp's beat is above the down-chirp's, the lidar recedes. Folds at N/2 are ignored. The
    sign counts as resolved when the chirps differ by more than three standard deviations of their difference, the
    residual is within three of its own, and no other explanation fits as well; see `least_squares`.

    Args:
        targets: (3,) of TARGET: one target per segment.
        length: N.
        farthest_bin: largest b that the instrument can observe.
    """
    up, constant, down = targets[0].frequency_bin, targets[1].frequency_bin, targets[2].frequency_bin
    up_var, constant_var, down_var = variances_bin2(targets)
    closing = not up > down
    longer, shorter = (down, up) if closing else (up, down)
    doppler = constant if closing else -constant
    # The beat of the lower chirp may have passed zero: its sign is the one with the smaller residual.
    excess = longer - 2.0 * constant
    if abs(excess - shorter) > abs(excess + shorter):
        shorter = -shorter
    g_up, g_down = (shorter, longer) if closing else (longer, shorter)
    residual = g_down - g_up - 2.0 * doppler
    weighting = _weigh(targets)
    spread = weighting.spread
    apart = (down - up) ** 2 > _RESOLVED_COST * (up_var + down_var)
    # Motion and the chirps' optical frequencies separate the segments' Doppler shifts by a fraction of a bin.
    consistent = abs(residual) <= np.sqrt(_RESOLVED_COST * spread) + 1.0
    resolved = (
        apart
        and consistent
        and not _has_rival(targets, weighting, length, farthest_bin, g_up, doppler, g_down)
    )
    range_var = (down_var if closing else up_var) + constant_var
    return Estimate(True, longer - constant, doppler, range_var, constant_var, residual, spread, resolved, 0)


@kernel
def least_squares(mask: int, targets: NDArray[Any], length: float, farthest_bin: float) -> Estimate:
    """Joint least squares over the segments with a target, with the signs and folds of least cost.

    The signed beat of a chirp is F, -F, N - F or F - N, and N + F where beats beyond N/2 can be observed; the constant
    segment's is F or -F, since a Doppler shift beyond N/2 moves all three tones by N and cannot be distinguished from
    its alias.

    With three segments an explanation (a choice of signs and folds) removes the residual r = g₋ - g₊ - 2 g₀ by
    corrections in proportion to the variances. It is admitted if b lies between 0 and `farthest_bin`, to three standard
    deviations. Its cost is r² over its variance, plus 9 for each fold at N/2. At equal cost a closing g₀ takes
    precedence, then the first g₊ and the first g₋ in the order above.

    The sign counts as resolved when every admitted explanation that differs by more than six standard deviations in b
    or d has an r² over its variance larger by 9, or by 9 times its own if the residual shows that the variances are too
    small. Folds do not count against a rival: they are improbable, but no frequency contradicts them. In particular
    N - b with -d gives the same three frequencies, so that nothing is resolved if it lies within `farthest_bin`.

    Two segments have no residual, and seldom a single explanation; see `_from_two`.

    Args:
        mask: bits of the segments that have a target: UP, CONSTANT, DOWN. Other targets are ignored.
        targets: (3,) of TARGET: one target per segment, with its observed frequency F₊, F₀ or F₋.
        length: N.
        farthest_bin: largest b that the instrument can observe.

    Returns:
        The estimate; not found with fewer than two segments or without an admitted explanation.
    """
    if mask == ALL:
        return _from_three(targets, length, farthest_bin)
    up, constant, down = targets[0].frequency_bin, targets[1].frequency_bin, targets[2].frequency_bin
    up_var, constant_var, down_var = variances_bin2(targets)
    if mask == UP | DOWN:
        variance = 0.25 * (up_var + down_var)
        return _from_two(mask, up, down, variance, variance, length, farthest_bin)
    if mask == UP | CONSTANT:
        return _from_two(mask, up, constant, up_var + constant_var, constant_var, length, farthest_bin)
    if mask == CONSTANT | DOWN:
        return _from_two(mask, down, constant, down_var + constant_var, constant_var, length, farthest_bin)
    return Estimate(False, np.nan, np.nan, np.nan, np.nan, np.nan, np.nan, False, 0)


@kernel
def variances_bin2(targets: NDArray[Any]) -> tuple[float, float, float]:
    """Variances of the targets of three segments, (3,) of TARGET."""
    return targets[0].variance_bin2, targets[1].variance_bin2, targets[2].variance_bin2


class _Weighting(NamedTuple):
    """Weighted least squares of three frequencies, by their variances.

    Signed beats with the residual r give b = (g₊ + g₋) / 2 + `range_share` r and d = g₀ + `doppler_share` r.
    """

    spread: float
    """Variance of the residual."""
    range_var: float
    doppler_var: float
    range_share: float
    doppler_share: float
    slack: float
    """Three standard deviations of b."""


@kernel
def _weigh(targets: NDArray[Any]) -> _Weighting:
    up_var, constant_var, down_var = variances_bin2(targets)
    spread = up_var + 4.0 * constant_var + down_var
    range_var = 0.25 * (up_var + down_var - (up_var - down_var) ** 2 / spread)
    doppler_var = constant_var - 4.0 * constant_var**2 / spread
    range_share, doppler_share = 0.5 * (up_var - down_var) / spread, 2.0 * constant_var / spread
    return _Weighting(spread, range_var, doppler_var, range_share, doppler_share, 3.0 * np.sqrt(range_var))


@kernel
def _from_three(targets: NDArray[Any], length: float, farthest_bin: float) -> Estimate:
    weighting = _weigh(targets)
    spread, range_var, doppler_var, range_share, doppler_share, slack = weighting
    if not spread < np.inf:
        return Estimate(False, np.nan, np.nan, np.nan, np.nan, np.nan, np.nan, False, 0)
    up, constant, down = targets[0].frequency_bin, targets[1].frequency_bin, targets[2].frequency_bin
    best_cost, best_up, best_constant, best_down, folds = np.inf, np.nan, np.nan, np.nan, 0
    choices = _chirp_choices(length, farthest_bin)
    for g_constant in (constant, -constant):
        for i in range(choices):
            g_up = _signed(up, i, length)
            for j in range(choices):
                g_down = _signed(down, j, length)
                residual = g_down - g_up - 2.0 * g_constant
                folding_cost = _FOLD_COST * ((i >> 1) + (j >> 1))
                # Most cost far too much, which is known without a division.
                if residual * residual > (best_cost - folding_cost) * spread * _ROUNDING:
                    continue
                cost = residual * residual / spread + folding_cost
                beat = 0.5 * (g_up + g_down) + range_share * residual
                if cost < best_cost and -slack <= beat <= farthest_bin + slack:
                    best_cost, best_up, best_constant, best_down = cost, g_up, g_constant, g_down
                    folds = (i >> 1) + (j >> 1)
    found = best_cost < np.inf
    residual = best_down - best_up - 2.0 * best_constant
    return Estimate(
        found,
        0.5 * (best_up + best_down) + range_share * residual,
        best_constant + doppler_share * residual,
        range_var,
        doppler_var,
        residual,
        spread,
        found and not _has_rival(targets, weighting, length, farthest_bin, best_up, best_constant, best_down),
        folds,
    )


@kernel
def _has_rival(
    targets: NDArray[Any],
    weighting: _Weighting,
    length: float,
    farthest_bin: float,
    own_up: float,
    own_constant: float,
    own_down: float,
) -> bool:
    up, constant, down = targets[0].frequency_bin, targets[1].frequency_bin, targets[2].frequency_bin
    spread, range_var, doppler_var, range_share, doppler_share, slack = weighting
    own = own_down - own_up - 2.0 * own_constant
    own_beat = 0.5 * (own_up + own_down) + range_share * own
    own_doppler = own_constant + doppler_share * own
    if _is_aliased(length, farthest_bin + slack, own_beat):
        return True
    limit = (own * own + _RESOLVED_COST * max(spread, own * own)) * _ROUNDING
    choices = _chirp_choices(length, farthest_bin)
    for g_constant in (constant, -constant):
        for i in range(choices):
            g_up = _signed(up, i, length)
            for j in range(choices):
                g_down = _signed(down, j, length)
                residual = g_down - g_up - 2.0 * g_constant
                if residual * residual > limit:
                    continue
                beat = 0.5 * (g_up + g_down) + range_share * residual
                doppler = g_constant + doppler_share * residual
                if -slack <= beat <= farthest_bin + slack and (
                    (beat - own_beat) ** 2 > _APART_VARIANCES * range_var
                    or (doppler - own_doppler) ** 2 > _APART_VARIANCES * doppler_var
                ):
                    return True
    return False


@kernel
def _is_aliased(length: float, farthest_bin: float, range_bin: float) -> bool:
    # With -d, N - b gives the same frequencies as b and d.
    return length - range_bin <= farthest_bin


@kernel
def _chirp_choices(length: float, farthest_bin: float) -> int:
    return 5 if farthest_bin > 0.5 * length else 4


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
    """Estimate from a chirp and either the other chirp or the constant segment.

    Explanations are admitted if 0 <= b <= `farthest_bin`, to three standard deviations, and |d| <= N/2. Among those
    with the fewest folds at N/2 the order of preference is

    1. one that is closing;
    2. one in which the tone of the third segment lies within _AC_COUPLED_BINS of 0, where AC coupling removes it: two
       chirps without a Doppler line are a hovering lidar if their tones are close together;
    3. one with |d| > b, as in nearly all of a landing: time to touchdown is then less than λS/c (97 s for a chirp of
       2 MHz/µs at 1.55 µm), and the third segment was lost by a fade.

    This chooses the most likely explanation. The sign counts as resolved only if no other explanation, with any number
    of folds, is admitted that differs by more than six standard deviations.
    """
    slack = 3.0 * np.sqrt(range_var) if range_var < np.inf else np.nan
    best_cost, best_range, best_doppler = np.inf, np.nan, np.nan
    rivalled = False
    for rivals in (False, True):
        if rivals and _is_aliased(length, farthest_bin + slack, best_range):
            rivalled = True
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
    resolved = found and not rivalled
    return Estimate(found, best_range, best_doppler, range_var, doppler_var, np.nan, np.nan, resolved, 0)


@kernel
def _signed(observed: float, choice: int, length: float) -> float:
    """Signed beat of an observed frequency: F, -F, N - F, F - N or N + F."""
    if choice == 4:
        return length + observed
    unfolded = observed if choice < 2 else length - observed
    return unfolded if choice % 2 == 0 else -unfolded


@kernel
def with_opposite_sign(usual: Estimate, mask: int, targets: NDArray[Any]) -> Estimate:
    """Estimate from a chirp and the Doppler line if the shift has the opposite sign.

    F₀ = |d| has no sign, so that g₊ = b - d or g₋ = b + d has a second solution with -d. For a closing lidar that uses
    the down-chirp it is b + 2d: too far by 2 c |v| / (λS), 193 s times the speed with 2 MHz/µs at 1.55 µm. With three
    segments the chirp with the higher beat is used; the other would contradict the result.

    Args:
        usual: estimate by the instrument's own estimator.
        mask: bits of the segments that have a target.
        targets: (3,) of TARGET: one target per segment.

    Returns:
        The solution with the least nonnegative b; not found without Doppler line, or where both chirps determine the
        sign.
    """
    up, constant, down = targets[0].frequency_bin, targets[1].frequency_bin, targets[2].frequency_bin
    up_var, constant_var, down_var = variances_bin2(targets)
    by_up = mask == UP | CONSTANT or (mask == ALL and up > down)
    doppler = -constant if usual.doppler_bin > 0.0 else constant
    chirp, chirp_var, toward = (up, up_var, doppler) if by_up else (down, down_var, -doppler)
    near, far = toward - chirp, toward + chirp
    beat = near if near >= 0.0 else far
    found = bool(usual.found) and mask & CONSTANT != 0 and beat >= 0.0
    resolved = found and usual.sign_resolved
    return Estimate(found, beat, doppler, chirp_var + constant_var, constant_var, np.nan, np.nan, resolved, 0)
