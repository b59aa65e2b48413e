"""Dust that the plume raises: it attenuates the ground's echo, and adds its own.

A sheet of uniform density lies on the ground. A beam whose one-way optical depth through it is τ receives exp(-2τ) of
the ground's echo. It also receives the dust's single-scattered light, as from a surface of albedo π (1 - exp(-2τ))/(2S)
with the lidar ratio S: the integral of backscatter α/S and two-way extinction over the path. This light comes from all
along the path, in parcels of equal optical depth with their own positions and speeds, or from one streak.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.flight.flight import sensor_height_m
from lidar_emu.flight.pointing import Pointing
from lidar_emu.fmcw.link_budget import coherent_power_w
from lidar_emu.fmcw.returns import Echoes
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.random_streams import DUST, RandomStream
from lidar_emu.numerics.vector_arrays import dot
from lidar_emu.scenario.plume import Plume
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scene.ray_hits import Hits

_PARCELS = 8
_LEAST_COSINE = 0.05
"""Minimum slope of a path through the sheet: 87 degrees off the vertical at most."""


class _Paths(NamedTuple):
    """Paths of beams (shots, beams) through the sheet."""

    length_m: FloatArray
    """Length of the path in the dust, up to the ground."""
    depth: FloatArray
    """One-way optical depth; 0 without dust or without ground."""
    in_streak: BoolArray


class Dust:
    """The dust of a scenario with a plume."""

    def __init__(self, scenario: FlightScenario, plume: Plume) -> None:
        self._scenario, self._plume = scenario, plume
        self._stream = RandomStream(scenario.seed, DUST)
        # One frequency per segment: only the stronger of ground and streak is detected.
        self._stronger_only = scenario.level == "statistical"

    def raised(self, echoes: Echoes, pointing: Pointing, axis_hits: Hits, shot: NDArray[np.int64]) -> Echoes:
        """Echoes of beams whose axes hit the ground at `axis_hits`, attenuated by the dust, with the dust's own
        echoes."""
        height_m = sensor_height_m(pointing, axis_hits)
        growth = self._growth(height_m)
        if not growth.any():
            return echoes
        paths = self._paths(pointing, axis_hits, growth, shot)
        parcels = self._parcels(echoes, pointing, axis_hits, paths, shot)
        streak_depth = np.where(paths.in_streak, self._plume.streak_optical_depth, 0.0)
        dimmed = echoes._replace(power_w=echoes.power_w * _passed(paths.depth + streak_depth)[..., None])
        return _stronger(dimmed, parcels) if self._stronger_only else _joined(dimmed, parcels)

    def _growth(self, height_m: FloatArray) -> FloatArray:
        onset_m, full_m = self._plume.onset_height_m, self._plume.full_height_m
        return np.clip((onset_m - height_m) / (onset_m - full_m), 0.0, 1.0)

    def _paths(
        self, pointing: Pointing, axis_hits: Hits, growth: FloatArray, shot: NDArray[np.int64]
    ) -> _Paths:
        plume, range_m = self._plume, axis_hits.range_m
        steep = np.maximum(-pointing.true_site[..., 2], _LEAST_COSINE)
        length_m = np.minimum(range_m, plume.thickness_m / steep)
        depth = growth[:, None] * plume.optical_depth * length_m / plume.thickness_m
        met = self._stream.uniforms(shot, range_m.shape[1], 0)[..., 0] < growth[:, None] * plume.streak_share
        return _Paths(length_m, np.where(range_m > 0, depth, 0.0), met & (range_m > 0))

    def _parcels(
        self,
        echoes: Echoes,
        pointing: Pointing,
        axis_hits: Hits,
        paths: _Paths,
        shot: NDArray[np.int64],
    ) -> Echoes:
        """Light of the dust as beamlets: the streak, if there is one, and the sheet's parcels from the top down."""
        beams = paths.depth.shape[1]
        drawn = np.stack([self._stream.uniforms(shot, beams, 1 + k) for k in range(1 + _PARCELS)], axis=-2)
        share = (np.arange(_PARCELS) + drawn[..., 1:, 0]) / _PARCELS
        place = np.concatenate([drawn[..., :1, 0], share], axis=-1)
        top_m = (axis_hits.range_m - paths.length_m)[..., None]
        range_m = top_m + place * paths.length_m[..., None]
        edge = paths.depth[..., None] * np.linspace(0.0, 1.0, 1 + _PARCELS)
        sent_back = np.concatenate(
            [
                (1.0 - _passed(self._plume.streak_optical_depth))
                * _passed(paths.depth[..., None] * place[..., :1]),
                _passed(edge[..., :-1]) - _passed(edge[..., 1:]),
            ],
            axis=-1,
        )
        behind = paths.in_streak[..., None] & (range_m > range_m[..., :1])
        sent_back = np.where(behind, _passed(self._plume.streak_optical_depth) * sent_back, sent_back)
        sent_back[..., 0] *= paths.in_streak
        power_w = self._white_w(range_m) * np.pi / (2.0 * self._plume.lidar_ratio_sr) * sent_back
        return echoes._replace(
            range_m=np.where(sent_back > 0.0, range_m, np.nan),
            closing_speed_mps=self._closing_mps(pointing, drawn[..., 1]),
            power_w=np.where(sent_back > 0.0, power_w, 0.0),
            range_rate_mps=np.broadcast_to(echoes.range_rate_mps[..., :1], range_m.shape),
        )

    def _closing_mps(self, pointing: Pointing, drawn: FloatArray) -> FloatArray:
        """Closing speed of dust that moves outward along the ground from below the sensor."""
        axis, plume = pointing.true_site, self._plume
        sensor_mps = np.asarray(dot(pointing.sensor_velocity_site_mps, axis))
        outward_mps = plume.speed_mps * (1.0 + plume.speed_spread * (2.0 * drawn - 1.0))
        return sensor_mps[..., None] - outward_mps * np.hypot(axis[..., 0], axis[..., 1])[..., None]

    def _white_w(self, range_m: FloatArray) -> FloatArray:
        """Echo of a white surface perpendicular to the beam."""
        site = self._scenario.site
        white = site.surface.model_copy(update={"reflectance": 1.0})
        return coherent_power_w(self._scenario.instrument, white, site.atmosphere, range_m, 1.0)


def _passed(depth: FloatArray | float) -> FloatArray:
    """Two-way transmission through an optical depth."""
    return np.asarray(np.exp(-2.0 * np.asarray(depth)))


def _joined(ground: Echoes, parcels: Echoes) -> Echoes:
    """Ground and dust as beamlets of the same beams, with the beam's speckle field and its motion within a
    measurement."""
    names = ("range_m", "closing_speed_mps", "power_w", "range_rate_mps")
    both = {name: np.concatenate([getattr(ground, name), getattr(parcels, name)], axis=-1) for name in names}
    return ground._replace(**both)


def _stronger(ground: Echoes, parcels: Echoes) -> Echoes:
    """The streak alone where it is stronger than the ground behind it, otherwise the ground."""
    streak_w = parcels.power_w[..., :1]
    wins = streak_w > ground.power_w.sum(axis=-1, keepdims=True)
    first = np.arange(ground.power_w.shape[-1]) == 0
    return ground._replace(
        range_m=np.where(wins, parcels.range_m[..., :1], ground.range_m),
        closing_speed_mps=np.where(wins, parcels.closing_speed_mps[..., :1], ground.closing_speed_mps),
        power_w=np.where(wins, np.where(first, streak_w, 0.0), ground.power_w),
    )
