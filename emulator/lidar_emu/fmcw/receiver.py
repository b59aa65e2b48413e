"""The receiver of one beam after another: echoes in, range and closing speed out."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.arrays import BoolArray, FloatArray
from lidar_emu.errors import InputError
from lidar_emu.fmcw.constants import BOLTZMANN_J_PER_K, ELEMENTARY_CHARGE_C, PLANCK_J_S
from lidar_emu.fmcw.measure import BEAM_RETURN, measure_beams
from lidar_emu.fmcw.spectrum import WINDOWS
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument, Receiver


class ReceiverModel(NamedTuple):
    """An instrument in the numbers that the receiver's kernels use."""

    fft_length: float
    range_bin_m: float
    """Range whose beat is one bin, c df / 2S."""
    speed_bin_mps: float
    """Closing speed whose Doppler shift is one bin, λ df / 2."""
    bin_width_hz: float
    snr_per_w: float
    """Power of a tone on its rectangular bin over the mean noise power there, per watt of echo."""
    window_centre: float
    window_side: float
    noise_power: float
    """Mean noise power of a windowed bin over that of a rectangular one."""
    threshold: float
    """Least power of a detected bin over the mean noise power."""
    group_power_share: float
    three_bin_peak: bool
    joint_estimate: bool
    maximum_range_m: float
    record_edge_range_m: float


@dataclass(frozen=True)
class Echoes:
    """What arrives from each beamlet of each beam."""

    range_m: FloatArray
    """(shots, beams, beamlets) At the time of validity; NaN where a beamlet meets nothing."""
    closing_speed_mps: FloatArray
    """(shots, beams, beamlets) Of the ground there, at the time of validity; positive toward the sensor."""
    power_w: FloatArray
    """(shots, beams, beamlets) In the mode of the local oscillator (`coherent_power_w` times the beamlet's
    share of the footprint); 0 where a beamlet meets nothing."""
    fired: BoolArray
    """(shots, beams)"""
    inside: BoolArray
    """(shots, beams) The sensor is below the ground."""


@dataclass(frozen=True)
class Returns:
    """What the instrument reports: arrays (shots, beams); NaN where it has nothing to report."""

    range_m: FloatArray
    closing_speed_mps: FloatArray
    range_valid: BoolArray
    speed_valid: BoolArray
    sign_resolved: BoolArray
    """Direction of motion and folds are beyond doubt, for closing speeds up to λ fs / 4 (232.5 m/s): beyond, every
    segment looks like an alias. The estimators say by which rule."""
    reason: NDArray[np.int8]
    """A `Reason`."""
    segments: NDArray[np.uint8]
    """Segments with a detection: bit 0 up-chirp, bit 1 constant, bit 2 down-chirp."""
    snr_db: FloatArray
    """Power of the highest bin over the noise, referred to a rectangular bin (the photons detected, for a
    tone on its bin): mean of the segments with a detection."""
    residual_mps: FloatArray
    """Speed from the two chirps less speed from the constant segment, λ (g₋ - g₊ - 2 g₀) / 4."""
    sigma_range_m: FloatArray
    """Standard deviation that the estimator's own variances give; of invalid measurements none."""
    sigma_speed_mps: FloatArray
    returns: NDArray[np.uint8]
    """Targets seen in all three segments, at most 4."""
    second_range_m: FloatArray
    """Range from the second strongest target of each segment."""
    segment_peak_hz: FloatArray
    """(shots, beams, 3) Frequency of the strongest target in up-chirp, constant segment and down-chirp."""


def build_receiver(instrument: Instrument) -> ReceiverModel:
    """The receiver's numbers from the instrument's description.

    Bin SNR is the number of photons detected coherently in a record, η_h η_q P T_rec / hν, over one plus the
    ratio of thermal to shot noise, (4kT/R_f) / (2 q I_LO): the local oscillator's shot noise and the
    amplifier's thermal noise are all the noise there is. The threshold is -ln(P_fa / (N/2)) times the mean
    noise power.

    Raises:
        InputError: the responsivity exceeds one electron per photon.
    """
    waveform, detection, receiver = instrument.waveform, instrument.detection, instrument.receiver
    _refuse_gain(instrument)
    bin_hz = waveform.bin_width_hz
    electrons_per_w = receiver.responsivity_a_per_w * waveform.record_time_s / ELEMENTARY_CHARGE_C
    window = WINDOWS[detection.window]
    return ReceiverModel(
        fft_length=float(waveform.fft_length),
        range_bin_m=SPEED_OF_LIGHT_MPS * bin_hz / (2.0 * waveform.chirp_slope_hz_per_s),
        speed_bin_mps=waveform.wavelength_m * bin_hz / 2.0,
        bin_width_hz=bin_hz,
        snr_per_w=instrument.optics.heterodyne_efficiency
        * electrons_per_w
        / (1.0 + _thermal_over_shot(receiver)),
        window_centre=window.centre,
        window_side=window.side,
        noise_power=window.noise_power,
        threshold=float(np.log(waveform.fft_length / 2) - np.log(detection.false_alarm_probability)),
        group_power_share=detection.group_fraction**2,
        three_bin_peak=detection.peak == "hann",
        joint_estimate=detection.combine == "least_squares",
        maximum_range_m=detection.maximum_range_m,
        record_edge_range_m=waveform.record_edge_range_m,
    )


def receive(model: ReceiverModel, echoes: Echoes, shot: NDArray[np.int64], seed: int) -> Returns:
    """Measure every beam of every shot: three spectra, their targets, range and closing speed.

    The beamlets of a beam add in phase at the centre of each record. Beamlet i has the real amplitude share
    P_i / sqrt(P), P the sum over the beam, so that a beam whose beamlets lie within a small part of a bin
    returns all of P; these shares are the place for speckle, which makes them circular complex Gaussian
    weights of mean square P_i. A phase common to the beam is uniform in each segment. Noise is drawn in the
    bins around the tones only.

    A beamlet beyond the record edge returns nothing; one at range 0 or less means contact with the ground.
    What is drawn depends on seed, shot and beam alone, so that the bits of a shot are the same in any block.

    Args:
        model: from `build_receiver`.
        echoes: shaped (shots, beams, beamlets).
        shot: (shots,) numbers of the shots.
        seed: 64 bits, of everything drawn.
    """
    rows = np.zeros(echoes.fired.shape, dtype=BEAM_RETURN)
    measure_beams(
        model,
        np.ascontiguousarray(echoes.range_m, dtype=float),
        np.ascontiguousarray(echoes.closing_speed_mps, dtype=float),
        np.ascontiguousarray(echoes.power_w, dtype=float),
        np.ascontiguousarray(echoes.fired),
        np.ascontiguousarray(echoes.inside),
        np.ascontiguousarray(shot, dtype=np.int64),
        np.uint64(seed),
        rows,
    )
    return Returns(*(np.ascontiguousarray(rows[field.name]) for field in fields(Returns)))


def _refuse_gain(instrument: Instrument) -> None:
    wavelength_m = instrument.waveform.wavelength_m
    limit_a_per_w = ELEMENTARY_CHARGE_C * wavelength_m / (PLANCK_J_S * SPEED_OF_LIGHT_MPS)
    given_a_per_w = instrument.receiver.responsivity_a_per_w
    if given_a_per_w > limit_a_per_w:
        raise InputError(
            f"instrument {instrument.name}",
            "receiver.responsivity_a_per_w",
            given_a_per_w,
            f"allowed: at most {limit_a_per_w:.4f} A/W, one electron per photon at {wavelength_m * 1e9:g} nm",
        )


def _thermal_over_shot(receiver: Receiver) -> float:
    thermal_a2_per_hz = 4.0 * BOLTZMANN_J_PER_K * receiver.temperature_k / receiver.transimpedance_ohm
    current_a = receiver.responsivity_a_per_w * receiver.local_oscillator_power_w
    return thermal_a2_per_hz / (2.0 * ELEMENTARY_CHARGE_C * current_a)
