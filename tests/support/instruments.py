"""Instruments without the effects that a test is not about, and echoes in any shape."""

from __future__ import annotations

from typing import Any

import numpy as np

from lidar_emu.numerics.kernels import with_fields
from lidar_emu.receiver.records import BEAM, TARGET
from lidar_emu.receiver.returns import Echoes
from lidar_emu.scenario.instrument import Detection, Instrument, Optics, Receiver, Waveform

C_MPS = 299_792_458.0

PLAIN_RECEIVER = Receiver(
    dark_current_a=0.0,
    relative_intensity_noise_db_per_hz=None,
    bandwidth_hz=None,
    ac_coupling_hz=0.0,
    adc=None,
)
"""Shot noise and the amplifier's thermal noise, and nothing else."""


def plain(waveform: dict[str, Any] | None = None, **detection: Any) -> Instrument:
    """No linewidth, no speckle, a flat and ideal receiver; changes of waveform and detection."""
    return Instrument(
        waveform=Waveform(**({"linewidth_hz": 0.0} | (waveform or {}))),
        optics=Optics(speckle=False),
        receiver=PLAIN_RECEIVER,
        detection=Detection(**detection),
    )


PLAIN = plain()


def echoes(
    range_m: object,
    speed_mps: object,
    power_w: object = 1e-11,
    range_rate_mps: object = 0.0,
    travel_per_s: float = 0.0,
) -> Echoes:
    """Beams of one beamlet each, in one shot; or whatever shape (shots, beams, beamlets) is given.

    Each shot has its own speckle, whose footprint travels so many pitches in a second.

    By default the beam's range stays as it is, as for a beam that slides over rising ground, and the
    closing speed too: all three records measure one range and one speed.
    """
    given = (range_m, speed_mps, power_w, range_rate_mps)
    arrays = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in given))
    shaped = [np.array(a if a.ndim == 3 else np.reshape(a, (1, -1, 1))) for a in arrays]
    beams = shaped[0].shape[:2]
    fired = np.ones(beams, dtype=bool)
    return Echoes(
        *shaped,
        *(np.zeros(beams) for _ in range(4)),
        np.zeros((*beams, 6)),
        np.full((*beams, 3), (travel_per_s, 0.0, 0.0)),
        fired,
        ~fired,
    )


def beam_record(shot: int, beam: int, seed: int) -> Any:
    """The record by which the receiver's kernels know a beam."""
    records = np.zeros(1, dtype=BEAM)
    records["seed"], records["shot"], records["beam"] = seed, shot, beam
    return with_fields(records)[0]


def targets(frequency_bin: object, variance_bin2: object = 1 / 12) -> np.ndarray:
    """One target of each segment."""
    records = np.zeros(3, dtype=TARGET)
    records["frequency_bin"], records["variance_bin2"] = frequency_bin, variance_bin2
    return with_fields(records)


def beats_hz(
    waveform: Waveform, range_m: np.ndarray, speed_mps: np.ndarray, range_rate_mps: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Signed beats at the centres of the three records, from the frequency plan.

    The up-chirp ends at the optical frequency f, the down-chirp starts from it; each record lies at its segment's end.
    """
    slope, carrier_hz = waveform.chirp_slope_hz_per_s, C_MPS / waveform.wavelength_m
    doppler = 2.0 * np.asarray(speed_mps) / C_MPS
    up_hz = carrier_hz - slope * waveform.record_time_s / 2
    down_hz = carrier_hz - slope * (waveform.segment_time_s - waveform.record_time_s / 2)
    moved_m = range_rate_mps * waveform.segment_time_s
    early_hz, late_hz = (slope * 2.0 * (np.asarray(range_m) + s * moved_m) / C_MPS for s in (-1, 1))
    return (
        early_hz - (up_hz - early_hz) * doppler,
        carrier_hz * doppler,
        late_hz + (down_hz + late_hz) * doppler,
    )


def estimates(
    waveform: Waveform, beats: tuple[np.ndarray, np.ndarray, np.ndarray], combine: str
) -> tuple[np.ndarray, np.ndarray]:
    """Range and closing speed that the estimators make of closing beats: they take f to be the same in every record."""
    up_hz, constant_hz, down_hz = beats
    if combine == "least_squares":
        beat_hz, doppler_hz = (up_hz + down_hz) / 2, constant_hz + (down_hz - up_hz - 2 * constant_hz) / 3
    else:
        beat_hz, doppler_hz = down_hz - constant_hz, constant_hz
    return beat_hz * C_MPS / (2 * waveform.chirp_slope_hz_per_s), doppler_hz * waveform.wavelength_m / 2
