"""The receiver against records sampled from the laser's phase, of the same scatterers."""

from __future__ import annotations

import numpy as np
from beamlet_samples import ScattererPatches, measure_waveform
from beat_truth import BeatTruth
from instruments import echoes, plain
from outcomes import Extreme, Outcome, check_report, compare, joined

from lidar_emu.receiver.receiver import receive
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.returns import Reason

_JOINT = plain(peak="hann", combine="least_squares")
_SNR = 1e14


def _measure(range_m: float, speed_mps: float, acceleration_mps2: float) -> Outcome:
    model, waveform = build_receiver(_JOINT, left_out_share=0.0), _JOINT.waveform
    beams = echoes(range_m, speed_mps, _SNR / model.snr_per_w, range_rate_mps=-speed_mps)
    acceleration = np.full((1, 1), acceleration_mps2)
    beams = beams._replace(closing_acceleration_mps2=acceleration)
    returns = receive(model, beams, np.zeros(1, dtype=np.int64), 1)
    check_report(returns, _JOINT.detection.maximum_range_m)
    footprint = ScattererPatches(
        np.array([range_m]),
        np.array([speed_mps]),
        np.array([np.sqrt(_SNR)]),
        closing_acceleration_mps2=acceleration_mps2,
    )
    slow = measure_waveform(waveform, _JOINT.detection, footprint)
    assert slow.range_valid.all()
    observed = np.stack([target.frequency_bin[:, 0] for target in slow.targets], axis=-1)
    truth = BeatTruth(observed, np.repeat(slow.range_m, 2)[None], np.repeat(slow.closing_speed_mps, 2)[None])
    tones = np.abs(returns.segment_peak_hz.reshape(-1, 3) / waveform.bin_width_hz - observed)
    return compare(returns, truth, np.arange(1), tones, 1550e-9 * waveform.sample_rate_hz / 2)


def _all(cases: list[tuple[float, float, float]]) -> Outcome:
    return joined([_measure(*case) for case in cases])


_VALID = frozenset({Reason.VALID})
_SPEEDS = [(1000.0, v, 0.0) for v in (3.0, -30.0, 92.388, 180.0, 225.0, 300.0, 460.0)]
_RANGES = [(r, 50.0, 0.0) for r in (10.0, 500.0, 4000.0, 11_900.0)]
_GENTLE = [(2000.0, 50.0, a) for a in (1.0, -10.0, 30.0)]
_VIOLENT = [(2000.0, 50.0, a) for a in (100.0, -300.0, 1000.0)]

SLOW_TRUTH = [
    Extreme("v 3 to 460 m/s", _VALID, lambda: _all(_SPEEDS), "sampled records", beside=(1e-3, 1e-5)),
    Extreme("R 10 m to 11.9 km", _VALID, lambda: _all(_RANGES), "sampled records"),
    Extreme("acceleration to 30 m/s²", _VALID, lambda: _all(_GENTLE), "sampled records", beside=(1e-3, 1e-5)),
    Extreme(
        "acceleration to 1000 m/s²", _VALID, lambda: _all(_VIOLENT), "sampled records", beside=(10.7, 0.11)
    ),
]
