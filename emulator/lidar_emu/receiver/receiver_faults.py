"""Faulty receivers: the same kernels with modified constants."""

from __future__ import annotations

from collections.abc import Iterable

from lidar_emu.receiver.false_alarms import neighbour_exceedance
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.spectrum import WINDOWS
from lidar_emu.scenario.instrument import Detection

_SEGMENTS = ("up", "constant", "down")


def without_segments(model: ReceiverModel, names: Iterable[str]) -> ReceiverModel:
    """Receiver that loses these segments: `up`, `constant`, `down`."""
    lost = sum(1 << _SEGMENTS.index(name) for name in set(names))
    return model._replace(lost_segments=model.lost_segments | lost)


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
