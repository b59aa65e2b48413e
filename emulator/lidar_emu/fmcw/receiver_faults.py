"""Faulty receivers: the same kernels with modified constants, and one with the sign of the Doppler shift reversed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.fmcw.false_alarms import neighbour_exceedance
from lidar_emu.fmcw.range_speed_estimation import ALL, CONSTANT, UP, Estimate, variances_bin2
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.spectrum import WINDOWS
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scenario.instrument import Detection

_SEGMENTS = ("up", "constant", "down")


def without_segments(model: ReceiverModel, names: Iterable[str]) -> ReceiverModel:
    """Receiver that loses these segments: `up`, `constant`, `down`."""
    lost = sum(1 << _SEGMENTS.index(name) for name in set(names))
    return model._replace(lost_segments=model.lost_segments | lost)


def with_opposite_doppler_sign(model: ReceiverModel) -> ReceiverModel:
    """Receiver that resolves the Doppler sign ambiguity wrongly, see `with_opposite_sign`."""
    return model._replace(opposite_doppler_sign=True)


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
    return Estimate(found, beat, doppler, chirp_var + constant_var, constant_var, np.nan, np.nan, resolved)


def decimated(model: ReceiverModel, factor: int) -> ReceiverModel:
    """Receiver that samples only every Nth time, and estimates as if it sampled every time.

    The noise of all folds is within the remaining band: the SNR of a tone falls by the factor, and so does the number
    of bins in which noise can be detected.
    """
    return model._replace(
        sampled_length=model.sampled_length / factor,
        snr_per_w=model.snr_per_w / factor,
        signal_shot_per_w=model.signal_shot_per_w / factor,
        back_reflection=model.back_reflection._replace(snr=model.back_reflection.snr / factor),
        independent_share=model.independent_share / factor,
    )


def noisier(model: ReceiverModel, detection: Detection, noise_db: float) -> ReceiverModel:
    """Receiver with more noise in all bins, and the instrument's unchanged threshold."""
    ratio = 10.0 ** (noise_db / 10.0)
    threshold, response = model.threshold / ratio, model.response
    single = detection.looks == 1
    return model._replace(
        threshold=threshold,
        independent_share=1.0 - neighbour_exceedance(WINDOWS[detection.window], threshold) if single else 1.0,
        snr_per_w=model.snr_per_w / ratio,
        signal_shot_per_w=model.signal_shot_per_w / ratio,
        back_reflection=model.back_reflection._replace(snr=model.back_reflection.snr / ratio),
        haze=model.haze._replace(snr_per_m=model.haze.snr_per_m / ratio),
        response=response._replace(full_scale=response.full_scale / ratio**0.5),
    )
