"""Paths of beams through the dust that the plume raises: a uniform sheet on the ground, and streaks in it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.flight import sensor_height_m
from lidar_emu.beams.pointing import Pointing
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.random_streams import DUST, RandomStream
from lidar_emu.scenario.site import Plume
from lidar_emu.scene.ray_hits import Hits

_LEAST_COSINE = 0.05
"""Minimum slope of a path through the sheet: 87 degrees off the vertical at most."""


class DustPaths(NamedTuple):
    """Paths of beams through the dust, (shots, beams) unless stated otherwise."""

    near_m: FloatArray
    """Range at which the beam enters the sheet; NaN where it meets no ground."""
    ground_m: FloatArray
    """Range of the ground, where the sheet ends."""
    depth: FloatArray
    """One-way optical depth of the sheet; 0 without dust or without ground."""
    in_streak: BoolArray
    """Whether the beam meets a streak."""
    streak_place: FloatArray
    """Position of the streak along the path in the sheet, 0 to 1."""
    streak_mps: FloatArray
    """Outward speed of the streak along the ground."""
    outward: FloatArray
    """(shots, beams, 3) Horizontal unit vectors away from below the sensor, in the site frame."""
    slant: FloatArray
    """Component of the beam's axis along `outward`."""


class PlumeGeometry:
    """Where the beams of a flight meet the dust of its plume.

    Args:
        plume: the plume.
        seed: seed of the run.
    """

    def __init__(self, plume: Plume, seed: int) -> None:
        self._plume = plume
        self._stream = RandomStream(seed, DUST)

    def paths(self, pointing: Pointing, axis_hits: Hits, shot: NDArray[np.int64]) -> DustPaths | None:
        """Paths of beams whose axes hit the ground at `axis_hits`; None where no shot raises dust."""
        plume, range_m = self._plume, axis_hits.range_m
        height_m = sensor_height_m(pointing, axis_hits)
        onset_m, full_m = plume.onset_height_m, plume.full_height_m
        growth = np.clip((onset_m - height_m) / (onset_m - full_m), 0.0, 1.0)[:, None]
        if not growth.any():
            return None
        beams = range_m.shape[1]
        axis = pointing.true_site
        length_m = np.minimum(range_m, plume.thickness_m / np.maximum(-axis[..., 2], _LEAST_COSINE))
        depth = growth * plume.optical_depth * length_m / plume.thickness_m
        met = self._stream.uniforms(shot, beams, 0)[..., 0] < growth * plume.streak_share
        drawn = self._stream.uniforms(shot, beams, 1)
        slant = np.hypot(axis[..., 0], axis[..., 1])
        outward = np.zeros(axis.shape)
        outward[..., :2] = axis[..., :2] / np.maximum(slant, 1e-12)[..., None]
        return DustPaths(
            near_m=range_m - length_m,
            ground_m=range_m,
            depth=np.where(range_m > 0.0, depth, 0.0),
            in_streak=met & (range_m > 0.0),
            streak_place=drawn[..., 0],
            streak_mps=plume.speed_mps * (1.0 + plume.speed_spread * (2.0 * drawn[..., 1] - 1.0)),
            outward=outward,
            slant=slant,
        )
