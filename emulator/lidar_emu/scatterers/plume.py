"""Particles of the plume's dust: a sheet whose particles each have a speed of their own, and streaks of one speed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lidar_emu.flight.plume import DustPaths
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scatterers.haze import ParticleBeam, Volume, strew
from lidar_emu.scatterers.record_light import PosesAt, Scatterers
from lidar_emu.scenario.instrument import Waveform
from lidar_emu.scenario.plume import Plume

_PER_BIN = 4.0
"""Particles of the sheet per bin of its ranges and speeds."""

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

    def strew(
        self,
        paths: DustPaths,
        s: int,
        b: int,
        poses_at: PosesAt,
        from_s: float,
        to_s: float,
        rng: np.random.Generator,
    ) -> tuple[list[Scatterers], float]:
        """Strew the dust of beam b in shot s.

        Args:
            paths: paths of all beams through the dust.
            poses_at, from_s, to_s, rng: see `haze.strew`.

        Returns:
            The particles, and the amplitude of the light that returns from the ground relative to a beam without dust.
        """
        near_m, ground_m = float(paths.near_m[s, b]), float(paths.ground_m[s, b])
        depth, streak_depth = float(paths.depth[s, b]), 0.0
        streak_m = near_m + float(paths.streak_place[s, b]) * (ground_m - near_m)
        strewn = []
        if paths.in_streak[s, b]:
            streak_depth = self.plume.streak_optical_depth
            speed_mps = np.full(_LEAST_PARTICLES, paths.streak_mps[s, b])
            volume = self._volume(
                streak_m, streak_m + _STREAK_M, streak_depth, np.outer(speed_mps, paths.outward[s, b])
            )
            streak, _ = strew(self.beam, volume, poses_at, from_s, to_s, rng)
            before = depth * float(paths.streak_place[s, b])
            strewn.append(self._dimmed(streak, streak_m, np.exp(-before)))
        if depth > 0.0:
            speed_mps = self._speeds_mps(ground_m - near_m, float(paths.slant[s, b]), rng)
            volume = self._volume(near_m, ground_m, depth, np.outer(speed_mps, paths.outward[s, b]))
            sheet, depth_m = strew(self.beam, volume, poses_at, from_s, to_s, rng)
            behind = np.where(depth_m > streak_m, np.exp(-streak_depth), 1.0)
            strewn.append(self._dimmed(sheet, near_m, behind))
        return strewn, float(np.exp(-depth - streak_depth))

    def _volume(self, near_m: float, far_m: float, depth: float, velocity_mps: FloatArray) -> Volume:
        per_m = depth / (far_m - near_m)
        return Volume(near_m, far_m, per_m / self.plume.lidar_ratio_sr, per_m, velocity_mps)

    def _dimmed(self, strewn: Scatterers, range_m: float, amplitude: FloatArray | float) -> Scatterers:
        """Particles behind dust and air."""
        through_air = np.exp(-self.extinction_per_m * range_m)
        return strewn._replace(amplitude=through_air * amplitude * strewn.amplitude)

    def _speeds_mps(self, length_m: float, slant: float, rng: np.random.Generator) -> FloatArray:
        """Outward speeds (n,) of the sheet's particles in random order, one in each of equal steps."""
        plume, waveform = self.plume, self.waveform
        spread_mps = 2.0 * plume.speed_mps * plume.speed_spread
        bins = length_m / waveform.range_bin_m + spread_mps * slant / waveform.speed_bin_mps
        count = max(_LEAST_PARTICLES, int(_PER_BIN * bins))
        share = (rng.permutation(count) + rng.random(count)) / count
        return np.asarray(plume.speed_mps + spread_mps * (share - 0.5))
