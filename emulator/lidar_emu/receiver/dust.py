"""Dust that the plume raises: it attenuates the ground's echo, and returns light of its own.

A volume with the extinction α and the lidar ratio S returns α/S dr per steradian from each dr of a beam's path, as haze
does. A sheet of uniform density lies on the ground. A beam whose one-way optical depth through it is τ receives
exp(-2τ) of the ground's echo, and the sheet's light, ∫ α/S exp(-2αx) dx = (1 - exp(-2τ))/(2S), which the receiver
spreads over the beats of all its ranges and speeds. A streak is a layer in the sheet whose dust has one speed: one more
beamlet. Its particles cross the beam with that speed, so that its speckle changes from record to record, with the
correlation exp(-d²/w0²) over a way d, while the ground's stays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.plume_paths import DustPaths, PlumeGeometry
from lidar_emu.beams.pointing import Pointing
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.vector_arrays import dot
from lidar_emu.receiver.link_budget import backscatter_w
from lidar_emu.receiver.returns import DUST_W, Echoes
from lidar_emu.receiver.speckle_field import PITCH_W
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scenario.site import Plume
from lidar_emu.scene.ray_hits import Hits


class Dust:
    """The dust of a scenario with a plume."""

    def __init__(self, scenario: FlightScenario, plume: Plume) -> None:
        self._scenario, self._plume = scenario, plume
        self._geometry = PlumeGeometry(plume, scenario.seed)

    def raised(self, echoes: Echoes, pointing: Pointing, axis_hits: Hits, shot: NDArray[np.int64]) -> Echoes:
        """Echoes of beams whose axes hit the ground at `axis_hits`, attenuated by the dust, with the dust's light."""
        paths = self._geometry.paths(pointing, axis_hits, shot)
        if paths is None:
            return echoes
        behind = _passed(paths.depth) * self._past_streak(paths)
        dimmed = echoes._replace(
            power_w=echoes.power_w * behind[..., None], dust=self._sheet(paths, pointing)
        )
        return self._with_streak(dimmed, paths, pointing)

    def light(self, pointing: Pointing, axis_hits: Hits, shot: NDArray[np.int64]) -> FloatArray | None:
        """`Echoes.dust` of these beams, with the light of streaks; None where no shot raises dust."""
        paths = self._geometry.paths(pointing, axis_hits, shot)
        if paths is None:
            return None
        light = self._sheet(paths, pointing)
        light[..., DUST_W] += self._streak(paths)[1]
        return light

    def _sheet(self, paths: DustPaths, pointing: Pointing) -> FloatArray:
        """Light of the sheet, less what a streak hides."""
        before = _passed(paths.depth * paths.streak_place)
        hidden = (before - _passed(paths.depth)) * (1.0 - self._past_streak(paths))
        sent_back = 1.0 - _passed(paths.depth) - hidden
        plume = self._plume
        slowest_mps, fastest_mps = (
            self._closing_mps(paths, pointing, plume.speed_mps * (1.0 + sense * plume.speed_spread))
            for sense in (1.0, -1.0)
        )
        columns = (
            self._light_w(0.5 * (paths.near_m + paths.ground_m), sent_back),
            paths.near_m,
            paths.ground_m,
            paths.depth,
            slowest_mps,
            fastest_mps,
        )
        return np.stack(columns, axis=-1)

    def _with_streak(self, echoes: Echoes, paths: DustPaths, pointing: Pointing) -> Echoes:
        range_m, power_w = self._streak(paths)
        added = {
            "range_m": np.where(power_w > 0.0, range_m, np.nan),
            "closing_speed_mps": self._closing_mps(paths, pointing, paths.streak_mps),
            "power_w": power_w,
            "range_rate_mps": echoes.range_rate_mps[..., 0],
        }
        joined = {
            name: np.concatenate([getattr(echoes, name), values[..., None]], axis=-1)
            for name, values in added.items()
        }
        return echoes._replace(**joined, streak_drift_per_s=self._streak_drift_per_s(paths, pointing))

    def _streak_drift_per_s(self, paths: DustPaths, pointing: Pointing) -> FloatArray:
        """`Echoes.streak_drift_per_s`, including the change by the beam's rotation."""
        optics, axis = self._scenario.instrument.optics, pointing.true_site
        moving_mps = pointing.sensor_velocity_site_mps - paths.streak_mps[..., None] * paths.outward
        across_mps = np.linalg.norm(np.cross(moving_mps, axis), axis=-1)
        swing_radps = np.linalg.norm(np.cross(pointing.turning_site_radps, axis), axis=-1)
        rayleigh_m = np.pi * optics.waist_radius_m**2 / self._scenario.instrument.waveform.wavelength_m
        drift_per_s = np.hypot(across_mps, rayleigh_m * swing_radps) / (PITCH_W * optics.waist_radius_m)
        return np.where(paths.in_streak, drift_per_s, np.nan)

    def _streak(self, paths: DustPaths) -> tuple[FloatArray, FloatArray]:
        """Ranges of the streaks, and their light; 0 where a beam meets none."""
        range_m = paths.near_m + paths.streak_place * (paths.ground_m - paths.near_m)
        sent_back = _passed(paths.depth * paths.streak_place) * (1.0 - self._past_streak(paths))
        return range_m, self._light_w(range_m, sent_back)

    def _past_streak(self, paths: DustPaths) -> FloatArray:
        return _passed(np.where(paths.in_streak, self._plume.streak_optical_depth, 0.0))

    def _closing_mps(
        self, paths: DustPaths, pointing: Pointing, outward_mps: FloatArray | float
    ) -> FloatArray:
        """Closing speed of dust that moves outward along the ground from below the sensor."""
        sensor_mps = np.asarray(dot(pointing.sensor_velocity_site_mps, pointing.true_site))
        return np.asarray(sensor_mps - outward_mps * paths.slant)

    def _light_w(self, range_m: FloatArray, sent_back: FloatArray) -> FloatArray:
        """Light of a volume at a range that sends back this share of twice the extinction's."""
        instrument, air = self._scenario.instrument, self._scenario.site.atmosphere
        share_per_sr = np.where(sent_back > 0.0, sent_back, 0.0) / (2.0 * self._plume.lidar_ratio_sr)
        return backscatter_w(instrument, air, np.where(np.isnan(range_m), 0.0, range_m)) * share_per_sr


def _passed(depth: FloatArray) -> FloatArray:
    return np.asarray(np.exp(-2.0 * depth))
