"""Particles of haze, strewn at random over the volume that a beam lights.

A particle stands for the many of a volume, as a scatterer for the grains of its patch (`scatterers.surface`): a volume
V returns the radiant intensity β V I, without depolarisation, since the particles are taken to be spheres. Particles
lie at random depths, one in each slice of a quarter of a range bin. Across the beam they are drawn from a mixture of
Gaussians along the beam's path, with the density q, and stand for the area 1/q. The Gaussians have the profile
exp(-4r²/w²) of the two-way intensity: all particles of a beam at rest return the same mean power, so that few of them
make a bin of Gaussian light. The numbers drawn are a sequence of low discrepancy with a random origin.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.vector_arrays import unit_across
from lidar_emu.scatterers.record_light import GaussianMode, PosesAt, Scatterers
from lidar_emu.scenario.instrument import Instrument
from lidar_emu.scenario.site import Atmosphere

_SLICES_PER_BIN = 4.0

_MOST_PLACES = 256
"""Places along the path of the beam, at most; they are a third of a radius apart."""

_STEPS = 1.2207440846057596 ** -np.arange(1.0, 4.0)
"""Steps of a sequence of low discrepancy in three dimensions: powers of the root of x⁴ = x + 1."""


class HazyBeam(NamedTuple):
    """What the particles of an instrument in an atmosphere depend on."""

    mode: GaussianMode
    power_per_m3: float
    """SNR of a volume at the waist: β P η λ² (2/(π w0²))² times the SNR per watt."""
    extinction_per_m: float
    wind_mps: FloatArray
    """(3,) Velocity of the particles in the site frame."""
    slice_m: float

    @classmethod
    def of(cls, instrument: Instrument, air: Atmosphere, snr_per_w: float) -> HazyBeam:
        """Particles of an atmosphere in an instrument's beams."""
        mode, waveform = GaussianMode.of(instrument), instrument.waveform
        emitted_w = instrument.optics.laser_power_w * instrument.optics.optical_efficiency
        peak_per_m2 = 2.0 / (np.pi * mode.waist_m**2)
        power = snr_per_w * emitted_w * air.backscatter_per_m_sr * (waveform.wavelength_m * peak_per_m2) ** 2
        slice_m = waveform.range_bin_m / _SLICES_PER_BIN
        return cls(mode, power, air.extinction_per_m, np.array(air.wind_mps), slice_m)


def strew_haze(
    beam: HazyBeam, poses_at: PosesAt, from_s: float, to_s: float, range_m: float, rng: np.random.Generator
) -> Scatterers:
    """Strew particles that move with the wind, from the sensor to a range.

    Args:
        beam: constants of instrument and atmosphere.
        poses_at: poses of the beam.
        from_s, to_s: times of emission and reception that the measurement covers.
        range_m: where the beam ends.
        rng: random generator.
    """
    here = poses_at(np.zeros(1))
    sensor_m, axis = here.sensor_m[0], here.transmitted[0] + here.received[0]
    axis /= np.linalg.norm(axis)
    count = int(range_m / beam.slice_m)
    depth_m = beam.slice_m * (np.arange(count) + rng.random(count))
    radius_m = beam.mode.radius_m(depth_m)
    start_m, slope = _path(beam, poses_at, from_s, to_s, axis, sensor_m, range_m)
    drawn = (rng.random(3) + np.arange(count)[:, None] * _STEPS) % 1.0
    chosen = (drawn[:, 0] * len(start_m)).astype(int)
    first = unit_across(axis)
    plane = np.stack([first, np.cross(axis, first)])
    away_m = radius_m * np.sqrt(-0.25 * np.log1p(-drawn[:, 1]))
    turn = 2.0 * np.pi * drawn[:, 2]
    centre_m = (start_m[chosen] + depth_m[:, None] * slope[chosen]) @ plane.T
    place_m = centre_m + away_m[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    density_per_m2 = _density(place_m, start_m @ plane.T, slope @ plane.T, depth_m, radius_m)
    power = beam.power_per_m3 * beam.slice_m * np.exp(-2.0 * beam.extinction_per_m * depth_m) / density_per_m2
    number = rng.standard_normal(2 * count).view(complex)
    position_m = sensor_m + depth_m[:, None] * axis + place_m @ plane
    velocity_mps = np.broadcast_to(beam.wind_mps, position_m.shape)
    return Scatterers(position_m, velocity_mps, np.sqrt(0.5 * power) * number)


def _path(
    beam: HazyBeam,
    poses_at: PosesAt,
    from_s: float,
    to_s: float,
    axis: FloatArray,
    sensor_m: FloatArray,
    range_m: float,
) -> tuple[FloatArray, FloatArray]:
    """Offsets (places, 3) of the beam's axis across its middle one, at the sensor and per metre of depth, in the frame
    of the particles."""
    ends = poses_at(np.array([from_s, to_s]))
    moved_m = np.linalg.norm(np.diff(ends.sensor_m, axis=0) - (to_s - from_s) * beam.wind_mps)
    swept_m = np.linalg.norm(np.diff(ends.transmitted, axis=0)) * range_m
    steps = moved_m / beam.mode.waist_m + swept_m / beam.mode.radius_m(range_m)
    places = min(_MOST_PLACES, 2 + int(3.0 * steps))
    time_s = np.linspace(from_s, to_s, places)
    poses = poses_at(time_s)
    offset_m = poses.sensor_m - sensor_m - time_s[:, None] * beam.wind_mps
    slope = 0.5 * (poses.transmitted + poses.received)
    return offset_m - (offset_m @ axis)[:, None] * axis, slope - (slope @ axis)[:, None] * axis


def _density(
    place_m: FloatArray, start_m: FloatArray, slope: FloatArray, depth_m: FloatArray, radius_m: FloatArray
) -> FloatArray:
    """Density (n,) per square metre of the mixture at places (n, 2)."""
    total = np.zeros(len(depth_m))
    for begins_m, leans in zip(start_m, slope, strict=True):
        apart_m = place_m - begins_m - depth_m[:, None] * leans
        total += np.exp(-4.0 * np.sum(apart_m**2, axis=1) / radius_m**2)
    return np.asarray(total * 4.0 / (np.pi * radius_m**2 * len(start_m)))
