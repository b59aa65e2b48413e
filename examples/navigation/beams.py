"""One shot as a navigator wants it: where each beam points, and what it says, NaN where it says nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_protocol import Message

if TYPE_CHECKING:
    from lidar_emu.measurement import Measurement

Array = NDArray[np.float64]

UNSTATED_SIGMA_RANGE_M = 0.1
UNSTATED_SIGMA_SPEED_MPS = 1e-3
"""Where the link has no room for standard deviations, as a core set on CAN."""


class DataSheet(NamedTuple):
    """What a navigator knows of its lidar beforehand."""

    azimuth_deg: Array
    """(beams,) Around body z, from x to y; no link tells it."""
    angle_deg: Array
    """(beams,) From body z, where the link does not tell it, as a core set on CAN."""
    acceleration_s2: float
    """Metres that a range reads too long for each m/s^2 of closing acceleration: speed changes between two chirps."""


class Shot(NamedTuple):
    """All beams at one time of validity; arrays are (beams,) and (beams, 3)."""

    time_ns: int
    directions_body: Array
    """Unit vectors: x forward, y right, z down."""
    range_m: Array
    sigma_range_m: Array
    closing_speed_mps: Array
    """Positive toward the ground."""
    sigma_speed_mps: Array


def directions(angle_deg: Any, azimuth_deg: Any) -> Array:
    """Unit vectors (beams, 3) at angles from body z, and around it from x to y."""
    off, around = np.broadcast_arrays(np.radians(angle_deg), np.radians(azimuth_deg))
    return np.stack([np.sin(off) * np.cos(around), np.sin(off) * np.sin(around), np.cos(off)], axis=-1)


def from_message(message: Message, sheet: DataSheet) -> Shot | None:
    """What a packet says, or a set of CAN frames; None without a time, or with other beams than the data sheet's."""
    beams = message.beams
    if message.time_ns is None or len(beams) != len(sheet.azimuth_deg):
        return None
    told_deg = _numbers(beams, "beam_angle_deg")
    return Shot(
        message.time_ns,
        directions(np.where(np.isnan(told_deg), sheet.angle_deg, told_deg), sheet.azimuth_deg),
        _numbers(beams, "range_m", "range_valid"),
        _stated(_numbers(beams, "sigma_range_m"), UNSTATED_SIGMA_RANGE_M),
        _numbers(beams, "closing_speed_mps", "speed_valid"),
        _stated(_numbers(beams, "sigma_speed_mps"), UNSTATED_SIGMA_SPEED_MPS),
    )


def from_run(run: Measurement, k: int, sheet: DataSheet) -> Shot:
    """Shot k of `lidar_emu.simulate`: the same values without wire."""
    return Shot(
        int(run.time_ns[k, 0]),
        directions(run.beam_angle_deg[k], sheet.azimuth_deg),
        np.where(run.range_valid[k], run.range_m[k], np.nan),
        run.sigma_range_m[k],
        np.where(run.speed_valid[k], run.closing_speed_mps[k], np.nan),
        run.sigma_speed_mps[k],
    )


def _numbers(beams: Sequence[Mapping[str, Any]], name: str, flag: str | None = None) -> Array:
    values = [beam.get(name) if flag is None or beam[flag] else None for beam in beams]
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def _stated(sigma: Array, otherwise: float) -> Array:
    return np.where(sigma > 0, sigma, otherwise)
