"""The light of scatterers in a record: the two-way Gaussian mode along the exact motion.

A transmitted and a received Gaussian mode with the waist w0 at the aperture have, at the distance z along the axis and
r across it, the amplitude (w0/w) exp(-r²/w²) and the optical path

    z + r²/(2 Rc) - ψ/k,    1/Rc = z/(z² + zR²),    ψ = arctan(z/zR).

For light received at t from a scatterer that it meets at s = t - P/c, both are taken from the sensor's position at s,
the transmitted one with the beam's axis at the time of emission t - 2P/c, the received one with the axis at t: P is the
mean of both paths. In the frame of a sensor in uniform motion the light of a beam at rest travels along its axis, so
that only the position at s matters; the rotation of the beam during the light's travel parts the two axes. What is left
out is of the order (v/c)² of the delay, and the sensor's acceleration times the square of the travel time (1e-9 m).

The echo's phase is the laser's phase at t less that at t - 2P/c.
"""

from __future__ import annotations

from collections.abc import Callable
from math import atan, exp, log, sqrt
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import BoolArray, ComplexArray, FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vector_arrays import unit_across
from lidar_emu.reference.laser_sweep import Segment
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument

_NODES = 7
"""Times in a record at which amplitude and phase are exact; between them they follow the polynomial through these."""

_LEAST_POWER = 1e-9
"""Power of a scatterer, relative to the strongest one, below which it is dark during a record."""

_BLOCK = 64
"""Samples between two exact values of a sum of exponentials."""

# Its inverse as a factor: kernels multiply faster than they divide.
_S_PER_M = 1.0 / SPEED_OF_LIGHT_MPS


class GaussianMode(NamedTuple):
    """The mode of transmitter and receiver."""

    waist_m: float
    rayleigh_m: float
    wavenumber_per_m: float

    @classmethod
    def of(cls, instrument: Instrument) -> GaussianMode:
        """Mode of an instrument."""
        waist_m, wavelength_m = instrument.optics.waist_radius_m, instrument.waveform.wavelength_m
        return cls(waist_m, np.pi * waist_m**2 / wavelength_m, 2.0 * np.pi / wavelength_m)

    def rays_around(self, axis: FloatArray) -> FloatArray:
        """Unit vectors (13, 3) along an axis and around it, out to twice the divergence."""
        first = unit_across(axis)
        turn = np.exp(1j * np.pi / 3.0 * np.arange(6))
        tilt = self.waist_m / self.rayleigh_m * np.concatenate([[0.0], turn, 2.0 * turn])
        rays = axis + tilt.real[:, None] * first + tilt.imag[:, None] * np.cross(axis, first)
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def radius_m(self, range_m: FloatArray | float) -> FloatArray:
        """1/e² intensity radii at ranges, in their shape."""
        return np.asarray(self.waist_m * np.sqrt(1.0 + np.square(range_m / self.rayleigh_m)))


class BeamPoses(NamedTuple):
    """Poses of a beam at n times, in the site frame."""

    sensor_m: FloatArray
    """(n, 3) Centre of the aperture."""
    transmitted: FloatArray
    """(n, 3) Unit vectors along the axis of the transmitted mode."""
    received: FloatArray
    """(n, 3) Unit vectors along the axis of the received mode."""


PosesAt = Callable[[FloatArray], BeamPoses]
"""Poses at times (n,) from the time of validity, in seconds."""


class Scatterers(NamedTuple):
    """Points that scatter light."""

    position_m: FloatArray
    """(n, 3) Positions in the site frame at the time of validity."""
    velocity_mps: FloatArray
    """(n, 3) Velocities."""
    amplitude: ComplexArray
    """(n,) Amplitude and phase of the echo, for a scatterer at the centre of the aperture's mode."""

    def joined(self, others: Scatterers) -> Scatterers:
        """These and other scatterers."""
        return Scatterers(*(np.concatenate(pair) for pair in zip(self, others, strict=True)))


NO_SCATTERERS = Scatterers(np.empty((0, 3)), np.empty((0, 3)), np.empty(0, dtype=complex))


class RecordLight(NamedTuple):
    """The light of n scatterers in a record: Σ exp(q_i(y)) with polynomials q_i; its real part is sampled."""

    coefficients: ComplexArray
    """(n, K) of the powers 0 to K - 1 of y = (x - middle_s) / half_s, x the time from the record's centre."""
    middle_s: float
    half_s: float
    power: FloatArray
    """(n,) Largest power of each within the time covered."""
    arrival_s: FloatArray
    """(n,) Time from the record's centre at which light of this segment arrives; before, there is none."""
    delay_s: FloatArray
    """(n,)"""
    ripple_turns: float | None = None
    """Phase of the chirp's periodic deviation at the record's centre, in turns; None: none."""
    steady: bool = False
    """Whether its delay is too short for the laser's phase noise."""

    @property
    def mean_delay_s(self) -> float:
        """Mean delay by power; 0 without light."""
        return float(self.power @ self.delay_s / self.power.sum()) if len(self.power) else 0.0

    def chosen(self, which: BoolArray) -> RecordLight:
        """The light of some of the scatterers."""
        return self._replace(
            coefficients=self.coefficients[which],
            power=self.power[which],
            arrival_s=self.arrival_s[which],
            delay_s=self.delay_s[which],
        )

    @property
    def middle_frequency_hz(self) -> FloatArray:
        """(n,) Frequencies in the middle of the time covered."""
        return np.asarray(self.coefficients[:, 1].imag / (2.0 * np.pi * self.half_s))

    def frequencies_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency of any scatterer within the time covered; 0 without light."""
        if not len(self.coefficients):
            return 0.0, 0.0
        rates = self.coefficients.imag[:, 1:] * np.arange(1, _NODES)
        frequency_hz = rates @ np.vander([-1.0, 0.0, 1.0], _NODES - 1, increasing=True).T
        frequency_hz /= 2.0 * np.pi * self.half_s
        return float(frequency_hz.min()), float(frequency_hz.max())

    def times(self, gain: ComplexArray) -> RecordLight:
        """The same light with gains (n,)."""
        coefficients = self.coefficients.copy()
        coefficients[:, 0] += np.log(gain)
        return self._replace(coefficients=coefficients)

    def attenuated(self, share: float) -> RecordLight:
        """The same light with this share of its power."""
        fainter = self.times(np.full(len(self.power), sqrt(share), dtype=complex))
        return fainter._replace(power=share * self.power)

    def shifted(self, frequency_hz: float) -> RecordLight:
        """The same light times a tone, which is 1 at the record's centre."""
        coefficients = self.coefficients.copy()
        coefficients[:, 0] += 2j * np.pi * frequency_hz * self.middle_s
        coefficients[:, 1] += 2j * np.pi * frequency_hz * self.half_s
        return self._replace(coefficients=coefficients)

    def add_to(self, total: ComplexArray, start_s: float, step_s: float) -> None:
        """Add the light at equally spaced times from the record's centre to `total` (samples,)."""
        first = np.ceil((self.arrival_s - start_s) / step_s)
        place, step = (start_s - self.middle_s) / self.half_s, step_s / self.half_s
        _add_exponentials(self.coefficients, first, place, step, total)


def record_light(
    mode: GaussianMode,
    segment: Segment,
    poses_at: PosesAt,
    scatterers: Scatterers,
    from_s: float,
    to_s: float,
) -> RecordLight:
    """Compute the light that scatterers return to one record.

    The tone of a scatterer is Re exp(q): its frequency is positive where the laser's frequency at reception is above
    the echo's.

    Args:
        from_s, to_s: time covered, from the record's centre.
    """
    middle_s, half_s = 0.5 * (from_s + to_s), 0.5 * (to_s - from_s)
    if not len(scatterers.amplitude):
        return RecordLight(np.empty((0, _NODES), dtype=complex), middle_s, half_s, *np.empty((3, 0)))
    place, to_powers = _nodes()
    node_s = middle_s + half_s * place
    origin_m = poses_at(np.array([segment.centre_s + middle_s])).sensor_m[0]
    position_m = scatterers.position_m - origin_m + segment.centre_s * scatterers.velocity_mps
    farthest_s = 2.1 * float(np.sqrt(np.max(np.sum(position_m**2, axis=1)))) * _S_PER_M
    pose_from_s = from_s - farthest_s
    pose_middle_s, pose_half_s = 0.5 * (pose_from_s + to_s), 0.5 * (to_s - pose_from_s)
    poses = poses_at(segment.centre_s + pose_middle_s + pose_half_s * place)
    vectors = np.concatenate([poses.sensor_m - origin_m, poses.transmitted, poses.received], axis=1)
    shape = len(position_m), _NODES
    log_mode, delay_s = np.empty(shape), np.empty(shape)
    _evaluate(
        *mode,
        np.ascontiguousarray(position_m),
        np.ascontiguousarray(scatterers.velocity_mps),
        np.ascontiguousarray((to_powers @ vectors).T),
        pose_middle_s,
        pose_half_s,
        node_s,
        log_mode,
        delay_s,
    )
    exponents = log_mode + 2j * np.pi * _phase_cycles(segment, node_s, delay_s)
    coefficients = exponents @ to_powers.T
    coefficients[:, 0] += np.log(scatterers.amplitude)
    power = np.square(np.abs(scatterers.amplitude)) * np.exp(2.0 * log_mode.max(axis=1))
    lit = power > _LEAST_POWER * power.max()
    middle_delay_s = delay_s[lit, _NODES // 2]
    arrival_s = middle_delay_s - segment.start_to_centre_s
    return RecordLight(coefficients[lit], middle_s, half_s, power[lit], arrival_s, middle_delay_s)


def reflected_light(
    segment: Segment, range_m: float, amplitude: complex, from_s: float, to_s: float
) -> RecordLight:
    """Compute the light that a surface at rest in the instrument returns to one record; see `record_light`."""
    middle_s, half_s = 0.5 * (from_s + to_s), 0.5 * (to_s - from_s)
    place, to_powers = _nodes()
    delay_s = np.full((1, _NODES), 2.0 * range_m * _S_PER_M)
    cycles = _phase_cycles(segment, middle_s + half_s * place, delay_s)
    coefficients = 2j * np.pi * cycles @ to_powers.T
    coefficients[:, 0] += np.log(amplitude)
    power, first_s = np.array([abs(amplitude) ** 2]), delay_s[:, 0]
    arrival_s = first_s - segment.start_to_centre_s
    return RecordLight(coefficients, middle_s, half_s, power, arrival_s, first_s, steady=True)


def _nodes() -> tuple[FloatArray, FloatArray]:
    """Places (K,) of the nodes from -1 to 1, and the matrix (K, K) from values there to coefficients of powers."""
    place = -np.cos(np.pi * np.arange(_NODES) / (_NODES - 1))
    return place, np.linalg.inv(np.vander(place, increasing=True))


def _phase_cycles(segment: Segment, node_s: FloatArray, delay_s: FloatArray) -> FloatArray:
    """Phase of the laser less the echo's, (n, K), in cycles: whole ones are removed at the middle node.

    Only the change from the middle node is computed in full.
    """
    slope, carrier_hz = segment.slope_hz_per_s, segment.start_frequency_hz
    middle = _NODES // 2
    first_s = delay_s[:, middle, None]
    since_start_s = segment.start_to_centre_s + node_s[middle]
    at_middle = carrier_hz * first_s
    at_middle -= np.rint(at_middle)
    at_middle += slope * first_s * (since_start_s - 0.5 * first_s)
    later_s, growth_s = node_s - node_s[middle], delay_s - first_s
    chirped = later_s * first_s + growth_s * (since_start_s + later_s - first_s) - 0.5 * growth_s**2
    cycles: FloatArray = at_middle - np.rint(at_middle) + carrier_hz * growth_s + slope * chirped
    return cycles


@kernel
def _vector(pose: FloatArray, first: int, place: float, out: FloatArray) -> None:
    """Evaluate three of the polynomials (9, K) of a pose."""
    for axis in range(3):
        value = 0.0
        for power in range(pose.shape[1] - 1, -1, -1):
            value = value * place + pose[first + axis, power]
        out[axis] = value


@kernel
def _one_way(
    waist_m: float, rayleigh_m: float, wavenumber_per_m: float, offset_m: FloatArray, axis: FloatArray
) -> tuple[float, float]:
    """Logarithm of the amplitude of a mode, relative to the aperture's centre, and its optical path."""
    z_m = offset_m[0] * axis[0] + offset_m[1] * axis[1] + offset_m[2] * axis[2]
    r2_m2 = 0.0
    for side in range(3):
        across_m = offset_m[side] - z_m * axis[side]
        r2_m2 += across_m * across_m
    farness = z_m / rayleigh_m
    spread = 1.0 + farness * farness
    path_m = z_m + 0.5 * r2_m2 * z_m / (rayleigh_m * rayleigh_m * spread) - atan(farness) / wavenumber_per_m
    return -r2_m2 / (waist_m * waist_m * spread) - 0.5 * log(spread), path_m


@kernel(outermost=True, allocates=True)
def _evaluate(
    waist_m: float,
    rayleigh_m: float,
    wavenumber_per_m: float,
    position_m: FloatArray,
    velocity_mps: FloatArray,
    pose: FloatArray,
    pose_middle_s: float,
    pose_half_s: float,
    node_s: FloatArray,
    log_mode: FloatArray,
    delay_s: FloatArray,
) -> None:
    """Set logarithms of two-way amplitudes and delays (n, K) of light received at the nodes (K,)."""
    sensor_m, axis, offset_m = np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(position_m)):
        squared_m2 = 0.0
        for side in range(3):
            squared_m2 += position_m[i, side] ** 2
        travel_s = sqrt(squared_m2) * _S_PER_M
        for j in range(len(node_s)):
            # Each pass reduces the error of the path by v/c: 1e-3 m before the first, 1e-16 m after the second.
            for _ in range(2):
                met_s = node_s[j] - travel_s
                _vector(pose, 0, (met_s - pose_middle_s) / pose_half_s, sensor_m)
                for side in range(3):
                    offset_m[side] = position_m[i, side] + velocity_mps[i, side] * met_s - sensor_m[side]
                _vector(pose, 3, (met_s - travel_s - pose_middle_s) / pose_half_s, axis)
                out_log, out_m = _one_way(waist_m, rayleigh_m, wavenumber_per_m, offset_m, axis)
                _vector(pose, 6, (node_s[j] - pose_middle_s) / pose_half_s, axis)
                back_log, back_m = _one_way(waist_m, rayleigh_m, wavenumber_per_m, offset_m, axis)
                travel_s = 0.5 * (out_m + back_m) * _S_PER_M
            log_mode[i, j] = out_log + back_log
            delay_s[i, j] = (out_m + back_m) * _S_PER_M


@kernel(outermost=True)
def _add_exponentials(
    coefficients: ComplexArray,
    first: FloatArray,
    start: float,
    step: float,
    total: ComplexArray,
) -> None:
    """Add Σ exp(q_i(start + m step)) to `total` (samples,), from sample `first` (n,) of each on.

    Within a block the exponent is the cubic through four exact values, evaluated by repeated multiplication.
    """
    count = len(total)
    for i in range(len(coefficients)):
        m = max(0, int(first[i]))
        while m < count:
            q0 = _polynomial(coefficients[i], start + m * step)
            q1 = _polynomial(coefficients[i], start + (m + 1) * step)
            q2 = _polynomial(coefficients[i], start + (m + 2) * step)
            q3 = _polynomial(coefficients[i], start + (m + 3) * step)
            value = _exponential(q0)
            ratio = _exponential(q1 - q0)
            bend = _exponential(q2 - 2.0 * q1 + q0)
            twist = _exponential(q3 - 3.0 * (q2 - q1) - q0)
            last = min(count, m + _BLOCK)
            while m < last:
                total[m] += value
                value *= ratio
                ratio *= bend
                bend *= twist
                m += 1


@kernel
def _polynomial(coefficients: ComplexArray, place: float) -> complex:
    value: complex = coefficients[-1]
    for power in range(len(coefficients) - 2, -1, -1):
        value = value * place + coefficients[power]
    return value


@kernel
def _exponential(exponent: complex) -> complex:
    size = exp(exponent.real)
    return complex(size * np.cos(exponent.imag), size * np.sin(exponent.imag))
