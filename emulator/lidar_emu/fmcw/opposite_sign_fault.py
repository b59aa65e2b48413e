"""Doppler sign ambiguity of a homodyne receiver: the same beats, interpreted with the opposite sign of the shift."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.fmcw.range_speed_estimation import ALL, CONSTANT, UP, Estimate
from lidar_emu.numerics.kernels import kernel


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
    up_var, constant_var, down_var = (
        targets[0].variance_bin2,
        targets[1].variance_bin2,
        targets[2].variance_bin2,
    )
    by_up = mask == UP | CONSTANT or (mask == ALL and up > down)
    doppler = -constant if usual.doppler_bin > 0.0 else constant
    chirp, chirp_var, toward = (up, up_var, doppler) if by_up else (down, down_var, -doppler)
    near, far = toward - chirp, toward + chirp
    beat = near if near >= 0.0 else far
    found = bool(usual.found) and mask & CONSTANT != 0 and beat >= 0.0
    resolved = found and usual.sign_resolved
    return Estimate(found, beat, doppler, chirp_var + constant_var, constant_var, np.nan, np.nan, resolved)
