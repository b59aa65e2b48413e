"""The other branch of a homodyne receiver: the same beats, explained by the other sign of the Doppler shift."""

from __future__ import annotations

import numpy as np

from lidar_emu.fmcw.estimation import ALL, CONSTANT, UP, Estimate
from lidar_emu.numerics.kernels import kernel


@kernel
def with_opposite_sign(
    usual: Estimate,
    mask: int,
    up: float,
    constant: float,
    down: float,
    up_var: float,
    constant_var: float,
    down_var: float,
) -> Estimate:
    """What a chirp and the Doppler line also say, if the shift is the other way round.

    F₀ = |d| has no sign, so that g₊ = b - d or g₋ = b + d has a second solution with -d. For a closing lidar that goes
    by the down-chirp it is b + 2d: too far by 2 c |v| / (λS), 193 s times the speed with 2 MHz/µs at 1.55 µm. Of
    three segments the longer chirp is taken; the shorter one would refute it.

    Args:
        usual: what the instrument's own estimator makes of them.
        mask: bits of the segments whose frequencies exist.
        up, constant, down: observed frequencies F₊, F₀, F₋ in bins.
        up_var, constant_var, down_var: their variances.

    Returns:
        The least b that is not negative; not found without Doppler line, or where both chirps tell the sign.
    """
    by_up = mask == UP | CONSTANT or (mask == ALL and up > down)
    doppler = -constant if usual.doppler_bin > 0.0 else constant
    chirp, chirp_var, toward = (up, up_var, doppler) if by_up else (down, down_var, -doppler)
    near, far = toward - chirp, toward + chirp
    beat = near if near >= 0.0 else far
    found = bool(usual.found) and mask & CONSTANT != 0 and beat >= 0.0
    return Estimate(
        found, beat, doppler, chirp_var + constant_var, constant_var, np.nan, found and usual.sign_resolved
    )
