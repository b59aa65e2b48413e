"""Particles of haze and of a plume's dust, sampled at random over their volume.

A particle stands for the many of a volume, as a scatterer for the grains of its patch (`reference.surface`): a volume
V returns the radiant intensity β V I, without depolarisation, since the particles are taken to be spheres. Particles
lie at random depths, one in each of equal slices. Across the beam they are drawn from a mixture of Gaussians along the
beam's path, with the density q, and stand for the area 1/q. The Gaussians have the profile exp(-4r²/w²) of the two-way
intensity: all particles of a beam at rest return the same mean power, so that few of them make a bin of Gaussian light.
The numbers drawn are a sequence of low discrepancy with a random origin.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lidar_emu.beams.plume_paths import DustPaths
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.vector_arrays import unit_across
from lidar_emu.reference.record_light import GaussianMode, PosesAt, Scatterers
from lidar_emu.scenario.instrument import Instrument, Waveform
from lidar_emu.scenario.site import Atmosphere, Plume

_PER_BIN = 4.0
"""Particles per bin of a volume's ranges, and of a sheet's ranges and speeds."""

_MOST_PLACES = 256
"""Places along the path of the beam, at most; they are a third of a radius apart."""

_STEPS = 1.2207440846057596 ** -np.arange(1.0, 4.0)
"""Steps of a sequence of low discrepancy in three dimensions: powers of the root of x⁴ = x + 1."""


class Volume(NamedTuple):
    """Particles between two depths of a beam."""

    near_m: float
    far_m: float
    backscatter_per_m_sr: float
    extinction_per_m: float
    """Extinction between the particles, from the near end on."""
    velocity_mps: FloatArray
    """(n, 3) Velocity of each particle in the site frame: a particle for each slice."""


class ParticleBeam(NamedTuple):
    """What the light of particles depends on beside their volume."""

    mode: GaussianMode
    power_m2: float
    """SNR of a volume at the waist per backscatter and cubic metre: P η λ² (2/(π w0²))² times the SNR per watt."""
    range_bin_m: float

    @classmethod
    def of(cls, instrument: Instrument, snr_per_w: float) -> ParticleBeam:
        """Beams of an instrument."""
        mode, waveform = GaussianMode.of(instrument), instrument.waveform
        emitted_w = instrument.optics.laser_power_w * instrument.optics.optical_efficiency
        peak_per_m2 = 2.0 / (np.pi * mode.waist_m**2)
        power = snr_per_w * emitted_w * (waveform.wavelength_m * peak_per_m2) ** 2
        return cls(mode, power, waveform.range_bin_m)

    def haze(self, air: Atmosphere, range_m: float) -> Volume:
        """Haze from the sensor to a range."""
        count = int(_PER_BIN * range_m / self.range_bin_m)
        velocity_mps = np.broadcast_to(np.array(air.wind_mps), (count, 3))
        return Volume(0.0, range_m, air.backscatter_per_m_sr, air.extinction_per_m, velocity_mps)


def sample(
    beam: ParticleBeam,
    volume: Volume,
    poses_at: PosesAt,
    from_s: float,
    to_s: float,
    rng: np.random.Generator,
) -> tuple[Scatterers, FloatArray]:
    """Sample the particles of a volume.

    Args:
        from_s, to_s: times of emission and reception that the measurement covers.

    Returns:
        The particles, and their depths (n,).
    """
    here = poses_at(np.zeros(1))
    sensor_m, axis = here.sensor_m[0], here.transmitted[0] + here.received[0]
    axis /= np.linalg.norm(axis)
    count, length_m = len(volume.velocity_mps), volume.far_m - volume.near_m
    depth_m = volume.near_m + length_m * (np.arange(count) + rng.random(count)) / max(1, count)
    radius_m = beam.mode.radius_m(depth_m)
    drawn = (rng.random(3) + np.arange(count)[:, None] * _STEPS) % 1.0
    first = unit_across(axis)
    plane = np.stack([first, np.cross(axis, first)])
    time_s, start_m, slope = _path(beam.mode, volume, poses_at, from_s, to_s, sensor_m, plane)
    chosen = (drawn[:, 0] * len(start_m)).astype(int)
    away_m = radius_m * np.sqrt(-0.25 * np.log1p(-drawn[:, 1]))
    turn = 2.0 * np.pi * drawn[:, 2]
    moving_mps = volume.velocity_mps @ plane.T
    centre_m = start_m[chosen] - time_s[chosen, None] * moving_mps + depth_m[:, None] * slope[chosen]
    place_m = centre_m + away_m[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    total = np.zeros(count)
    for at_s, begins_m, leans in zip(time_s, start_m, slope, strict=True):
        apart_m = place_m - begins_m + at_s * moving_mps - depth_m[:, None] * leans
        total += np.exp(-4.0 * np.sum(apart_m**2, axis=1) / radius_m**2)
    density_per_m2 = total * 4.0 / (np.pi * radius_m**2 * len(start_m))
    power = beam.power_m2 * volume.backscatter_per_m_sr * length_m / max(1, count) / density_per_m2
    power *= np.exp(-2.0 * volume.extinction_per_m * (depth_m - volume.near_m))
    number = rng.standard_normal(2 * count).view(complex)
    position_m = sensor_m + depth_m[:, None] * axis + place_m @ plane
    return Scatterers(position_m, volume.velocity_mps, np.sqrt(0.5 * power) * number), depth_m


def _path(
    mode: GaussianMode,
    volume: Volume,
    poses_at: PosesAt,
    from_s: float,
    to_s: float,
    sensor_m: FloatArray,
    plane: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times (places,), and offsets (places, 2) of the beam's axis across it, at the sensor and per metre of depth."""
    ends = poses_at(np.array([from_s, to_s]))
    moved_m = np.diff(ends.sensor_m, axis=0) - (to_s - from_s) * volume.velocity_mps
    swept_m = np.linalg.norm(np.diff(ends.transmitted, axis=0)) * volume.far_m
    furthest_m = np.max(np.linalg.norm(moved_m, axis=1), initial=0.0)
    steps = furthest_m / mode.waist_m + swept_m / mode.radius_m(volume.far_m)
    time_s = np.linspace(from_s, to_s, min(_MOST_PLACES, 2 + int(3.0 * steps)))
    poses = poses_at(time_s)
    slope = 0.5 * (poses.transmitted + poses.received)
    return time_s, (poses.sensor_m - sensor_m) @ plane.T, slope @ plane.T


_LEAST_PARTICLES = 256

_STREAK_M = 0.01
"""Thickness of a streak along the beam, far below a range bin."""


class DustyBeam(NamedTuple):
    """Particles of a plume's dust in the beams of an instrument."""

    beam: ParticleBeam
    plume: Plume
    waveform: Waveform
    extinction_per_m: float
    """Extinction of the atmosphere between the sensor and the dust."""

    def sample(
        self,
        paths: DustPaths,
        s: int,
        b: int,
        poses_at: PosesAt,
        from_s: float,
        to_s: float,
        rng: np.random.Generator,
    ) -> tuple[list[Scatterers], float]:
        """Sample the dust of beam b in shot s.

        Args:
            paths: paths of all beams through the dust.
            from_s, to_s: see `sample`.

        Returns:
            The particles, and the amplitude of the light that returns from the ground relative to a beam without dust.
        """
        near_m, ground_m = float(paths.near_m[s, b]), float(paths.ground_m[s, b])
        depth, streak_depth = float(paths.depth[s, b]), 0.0
        streak_m = near_m + float(paths.streak_place[s, b]) * (ground_m - near_m)
        sampled = []
        if paths.in_streak[s, b]:
            streak_depth = self.plume.streak_optical_depth
            speed_mps = np.full(_LEAST_PARTICLES, paths.streak_mps[s, b])
            volume = self._volume(
                streak_m, streak_m + _STREAK_M, streak_depth, np.outer(speed_mps, paths.outward[s, b])
            )
            streak, _ = sample(self.beam, volume, poses_at, from_s, to_s, rng)
            before = depth * float(paths.streak_place[s, b])
            sampled.append(self._dimmed(streak, streak_m, np.exp(-before)))
        if depth > 0.0:
            speed_mps = self._speeds_mps(ground_m - near_m, float(paths.slant[s, b]), rng)
            volume = self._volume(near_m, ground_m, depth, np.outer(speed_mps, paths.outward[s, b]))
            sheet, depth_m = sample(self.beam, volume, poses_at, from_s, to_s, rng)
            behind = np.where(depth_m > streak_m, np.exp(-streak_depth), 1.0)
            sampled.append(self._dimmed(sheet, near_m, behind))
        return sampled, float(np.exp(-depth - streak_depth))

    def _volume(self, near_m: float, far_m: float, depth: float, velocity_mps: FloatArray) -> Volume:
        per_m = depth / (far_m - near_m)
        return Volume(near_m, far_m, per_m / self.plume.lidar_ratio_sr, per_m, velocity_mps)

    def _dimmed(self, sampled: Scatterers, range_m: float, amplitude: FloatArray | float) -> Scatterers:
        through_air = np.exp(-self.extinction_per_m * range_m)
        return sampled._replace(amplitude=through_air * amplitude * sampled.amplitude)

    def _speeds_mps(self, length_m: float, slant: float, rng: np.random.Generator) -> FloatArray:
        """Outward speeds (n,) of the sheet's particles in random order, one in each of equal steps."""
        plume, waveform = self.plume, self.waveform
        spread_mps = 2.0 * plume.speed_mps * plume.speed_spread
        bins = length_m / waveform.range_bin_m + spread_mps * slant / waveform.speed_bin_mps
        count = max(_LEAST_PARTICLES, int(_PER_BIN * bins))
        share = (rng.permutation(count) + rng.random(count)) / count
        return np.asarray(plume.speed_mps + spread_mps * (share - 0.5))
