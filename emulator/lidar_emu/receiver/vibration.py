"""Vibration of the lidar: velocities of the three records of a measurement, and the errors that follow.

The acceleration along an axis of the body has the one-sided density W(f), and the velocity W/(2πf)². To first order a
record shows the velocity with weights over the record, x from -1/2 to 1/2. Least squares on its phase has the weights
3/2 - 6x², Aboutanios and Mulgrew's half bins π/2 cos πx, the three-bin formula for a Hann window (1 + cos 2πx)²/1.5.
With ν = f T_rec their transforms are

    G = 3 (sin πν - πν cos πν)/(πν)³,
    G = π/4 [sinc(ν - 1/2) + sinc(ν + 1/2)],    sinc ν = sin πν/πν,
    G = sinc ν + 2/3 [sinc(ν - 1) + sinc(ν + 1)] + 1/6 [sinc(ν - 2) + sinc(ν + 2)].

Records at -T, 0 and T from the time of validity, combined into range and closing speed, then have errors with the
densities of the velocity times the squares of these gains, relative to the velocity at the time of validity:

    least squares:        range c/(λS) G sin 2πfT,     speed G (1 + 2 cos 2πfT)/3 - 1;
    chirp minus Doppler:  range c/(λS) G 2 sin πfT,    speed G - 1;
    residual              G (1 - cos 2πfT).
"""

from __future__ import annotations

from dataclasses import replace
from math import pi
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import VIBRATION, generator, unit_phasor
from lidar_emu.receiver.footprint_depth import MOST_FREEDOM
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import Echoes, Returns
from lidar_emu.scenario.instrument import Instrument
from lidar_emu.scenario.vibration import Vibration, VibrationSpectrum

TONES = 256
"""Tones of the acceleration along an axis."""

_SHARES = {
    "hann": ((0.0, 1.0), (1.0, 2.0 / 3.0), (-1.0, 2.0 / 3.0), (2.0, 1.0 / 6.0), (-2.0, 1.0 / 6.0)),
    "aboutanios_mulgrew": ((0.5, 0.25 * pi), (-0.5, 0.25 * pi)),
}
"""Places and shares of the sinc functions in an estimator's transform; other estimators: least squares."""

_G_MPS2 = 9.80665
_NODES = 2048
"""Nodes of integrals between two points of a spectrum."""


def vibration_variances(vibration: Vibration | None, instrument: Instrument) -> FloatArray:
    """Variances (4, 3) of the errors of range and closing speed, of `residual_mps` and of the lidar's own speed, for
    beams along each axis of the body: a beam between them has the mean by the squares of its components."""
    variances = np.zeros((4, 3))
    for axis, spectrum in enumerate(() if vibration is None else vibration.axes):
        if spectrum is not None:
            frequency_hz, density = _density(spectrum)
            moving = density / (2.0 * pi * frequency_hz) ** 2
            gains = _gains(instrument, frequency_hz)
            variances[:, axis] = np.trapezoid(moving * gains**2, frequency_hz, axis=1)
    return variances


def _density(spectrum: VibrationSpectrum) -> tuple[FloatArray, FloatArray]:
    """Frequencies, and the density there in (m/s²)²/Hz."""
    log_points = np.log(spectrum.frequency_hz)
    point = np.arange(len(log_points))
    log_hz = np.interp(np.linspace(0, point[-1], _NODES * point[-1] + 1), point, log_points)
    shape = np.zeros(len(log_points)) if spectrum.g2_per_hz is None else np.log(spectrum.g2_per_hz)
    frequency_hz, density = np.exp(log_hz), _G_MPS2**2 * np.exp(np.interp(log_hz, log_points, shape))
    if spectrum.g_rms is not None:
        density *= (spectrum.g_rms * _G_MPS2) ** 2 / np.trapezoid(density, frequency_hz)
    return frequency_hz, density


def _record_gain(instrument: Instrument, frequency_hz: FloatArray) -> FloatArray:
    cycles, peak = frequency_hz * instrument.waveform.record_time_s, instrument.detection.peak
    if peak in _SHARES:
        return np.asarray(sum(share * np.sinc(cycles + side) for side, share in _SHARES[peak]))
    p = pi * cycles
    with np.errstate(invalid="ignore", divide="ignore"):
        gain = 3.0 * (np.sin(p) - p * np.cos(p)) / p**3
    return np.where(p < 0.01, 1.0 - 0.1 * p**2, gain)


def _gains(instrument: Instrument, frequency_hz: FloatArray) -> FloatArray:
    """Gains (4, frequencies) of the velocity, in the order of `vibration_variances`."""
    waveform = instrument.waveform
    gain, turn = _record_gain(instrument, frequency_hz), 2.0 * pi * frequency_hz * waveform.segment_time_s
    across, speed = np.sin(turn), gain * (1.0 + 2.0 * np.cos(turn)) / 3.0 - 1.0
    if instrument.detection.combine == "chirp_minus_doppler":
        across, speed = 2.0 * np.sin(0.5 * turn), gain - 1.0
    residual = gain * (1.0 - np.cos(turn))
    return np.stack([waveform.range_per_speed_s * gain * across, speed, residual, np.ones_like(gain)])


class Tones(NamedTuple):
    """Tones of the acceleration along the axes of the body, (3, TONES) each; an axis at rest has amplitudes of 0."""

    frequency_hz: FloatArray
    turn: FloatArray
    """Phase at scenario time 0 plus half a turn, in turns."""
    amplitude_mps2: FloatArray

    def displacement_body_m(self, time_s: FloatArray) -> FloatArray:
        """(n, 3) Displacement at n times."""
        turn = self.frequency_hz[:, None, :] * time_s[:, None] + self.turn[:, None, :]
        amplitude_m = self.amplitude_mps2 / (2.0 * pi * self.frequency_hz) ** 2
        return np.asarray(np.einsum("ati,ai->ta", np.cos(2.0 * pi * turn), amplitude_m))


def draw_tones(vibration: Vibration, seed: int) -> Tones:
    """Draw frequencies and phases.

    One frequency lies in each of `TONES` parts that are equal in the sum of logarithm of frequency and power, so that
    lines and wide bands have their tones. Sums over tones are unbiased estimates of integrals over the density.
    """
    tones = Tones(np.ones((3, TONES)), np.zeros((3, TONES)), np.zeros((3, TONES)))
    for axis, spectrum in enumerate(vibration.axes):
        if spectrum is None:
            continue
        frequency_hz, density = _density(spectrum)
        power = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(frequency_hz))])
        octaves = np.log(frequency_hz / frequency_hz[0])
        place, turn = generator(seed, axis, VIBRATION).random((2, TONES))
        share = 0.5 * (power / power[-1] + octaves / octaves[-1])
        chosen_hz = np.interp((np.arange(TONES) + place) / TONES, share, frequency_hz)
        chosen = np.interp(chosen_hz, frequency_hz, density)
        share_per_hz = 0.5 * (chosen / power[-1] + 1.0 / (chosen_hz * octaves[-1]))
        tones.frequency_hz[axis], tones.turn[axis] = chosen_hz, turn
        tones.amplitude_mps2[axis] = np.sqrt(2.0 * chosen / (TONES * share_per_hz))
    return tones


class RecordMotion(NamedTuple):
    """What vibration adds along beams, (shots, beams) each."""

    speed_mps: FloatArray
    """Closing speed at the time of validity."""
    record_speed_mps: FloatArray
    """Closing speed that the record of the constant segment shows."""
    acceleration_mps2: FloatArray
    jerk_mps3: FloatArray
    """With it, the parabola through the closing speeds that the three records show."""
    range_m2: FloatArray
    """Variance of the range."""
    speed_m2ps2: FloatArray
    """Variance of the closing speed."""

    def stated(self, returns: Returns) -> Returns:
        """Returns whose standard deviations contain the errors by vibration, which the instrument knows from tests."""
        sigma_m = np.sqrt(returns.sigma_range_m**2 + self.range_m2)
        with np.errstate(invalid="ignore", divide="ignore"):
            freedom = returns.range_degrees_of_freedom * (sigma_m / returns.sigma_range_m) ** 4
        return replace(
            returns,
            sigma_range_m=sigma_m,
            second_sigma_range_m=np.sqrt(returns.second_sigma_range_m**2 + self.range_m2),
            sigma_speed_mps=np.sqrt(returns.sigma_speed_mps**2 + self.speed_m2ps2),
            range_degrees_of_freedom=np.minimum(freedom, MOST_FREEDOM),
        )

    def added_to(self, echoes: Echoes) -> Echoes:
        """Echoes with this motion. The displacement, below a millimetre at 20 Hz and more, is left out."""
        return echoes._replace(
            closing_speed_mps=echoes.closing_speed_mps + self.record_speed_mps[..., None],
            closing_acceleration_mps2=echoes.closing_acceleration_mps2 + self.acceleration_mps2,
            closing_jerk_mps3=echoes.closing_jerk_mps3 + self.jerk_mps3,
            air_speed_mps=echoes.air_speed_mps + self.record_speed_mps,
        )


class VibratingLidar:
    """Vibration of a lidar in flight: any shot can be computed alone.

    Args:
        vibration: its spectra.
        instrument: the lidar, with one look.
        seed: of the run.
    """

    def __init__(self, vibration: Vibration, instrument: Instrument, seed: int) -> None:
        tones, segment_s = draw_tones(vibration, seed), instrument.waveform.segment_time_s
        self._variances = vibration_variances(vibration, instrument)
        speed_mps = tones.amplitude_mps2 / (2.0 * pi * tones.frequency_hz)
        shown_mps = speed_mps * _record_gain(instrument, tones.frequency_hz)
        turn = 2.0 * pi * tones.frequency_hz * segment_s
        chirps = shown_mps * np.sin(turn) / segment_s, 2.0 * shown_mps * (np.cos(turn) - 1.0) / segment_s**2
        self._tones = tones.frequency_hz, tones.turn, np.stack([speed_mps, shown_mps, *chirps], axis=1)

    def motion(self, time_ns: IntArray, axis_body: FloatArray) -> RecordMotion:
        """Motion along beams.

        Args:
            time_ns: (shots, beams) times of validity.
            axis_body: (shots, beams, 3) published unit vectors along the beams.
        """
        motion, add = np.zeros((4, *time_ns.shape)), cast(Any, _set_motion)
        add(*self._tones, time_ns, np.ascontiguousarray(axis_body), motion)
        return RecordMotion(*motion, *(np.square(axis_body) @ each for each in self._variances[:2]))


@kernel(outermost=True)
def _set_motion(
    frequency_hz: FloatArray,
    turn: FloatArray,
    gains: FloatArray,
    time_ns: NDArray[np.int64],
    axis_body: FloatArray,
    motion: FloatArray,
) -> None:
    for s in range(time_ns.shape[0]):
        for axis in range(3):
            moving = gains[axis, 0, 0] > 0.0
            speed = record_speed = acceleration = jerk = 0.0
            for b in range(time_ns.shape[1]):
                if moving and (b == 0 or time_ns[s, b] != time_ns[s, b - 1]):
                    speed = record_speed = acceleration = jerk = 0.0
                    for i in range(TONES):
                        turns = frequency_hz[axis, i] * (1e-9 * time_ns[s, b]) + turn[axis, i]
                        cosine, sine = unit_phasor(turns - np.floor(turns))
                        speed += gains[axis, 0, i] * sine
                        record_speed += gains[axis, 1, i] * sine
                        acceleration += gains[axis, 2, i] * cosine
                        jerk += gains[axis, 3, i] * sine
                along = axis_body[s, b, axis]
                motion[0, s, b] += along * speed
                motion[1, s, b] += along * record_speed
                motion[2, s, b] += along * acceleration
                motion[3, s, b] += along * jerk


def with_vibration(
    model: ReceiverModel, vibration: Vibration | None, instrument: Instrument
) -> ReceiverModel:
    """The receiver, which accepts residuals as large as vibration along any axis of the body makes them."""
    vibration_bin2 = 4.0 * float(vibration_variances(vibration, instrument)[2].max()) / model.speed_bin_mps**2
    return model._replace(residual_limit=model.residual_limit._replace(vibration_bin2=vibration_bin2))
