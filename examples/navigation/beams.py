"""A shot as input of a navigator: direction and measurement of each beam, NaN where a measurement is missing."""

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
"""Standard deviations where the link does not carry them, as with the core set on CAN."""


class DataSheet(NamedTuple):
    """Properties of the lidar that a navigator needs in advance."""

    azimuth_deg: Array
    """(beams,) Azimuth about body z, from x to y; no link carries it."""
    angle_deg: Array
    """(beams,) Angle from body z, where the link does not carry it, as with the core set on CAN."""
    acceleration_s2: float
    """Bias of a range in metres per m/s^2 of closing acceleration, because the speed changes between the two chirps."""


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
    """Unit vectors (beams, 3) at angles from body z and azimuths about it from x to y."""
    off, around = np.broadcast_arrays(np.radians(angle_deg), np.radians(azimuth_deg))
    return np.stack([np.sin(off) * np.cos(around), np.sin(off) * np.sin(around), np.cos(off)], axis=-1)


def from_message(message: Message, sheet: DataSheet) -> Shot | None:
    """Shot from a packet or a set of CAN frames; None without a time, or if its beams differ from the data sheet's."""
    beams = message.beams
    if message.time_ns is None or len(beams) != len(sheet.azimuth_deg):
        return None
    stated_deg = _numbers(beams, "beam_angle_deg")
    return Shot(
        message.time_ns,
        directions(np.where(np.isnan(stated_deg), sheet.angle_deg, stated_deg), sheet.azimuth_deg),
        _numbers(beams, "range_m", "range_valid"),
        _stated(_numbers(beams, "sigma_range_m"), UNSTATED_SIGMA_RANGE_M),
        _numbers(beams, "closing_speed_mps", "speed_valid"),
        _stated(_numbers(beams, "sigma_speed_mps"), UNSTATED_SIGMA_SPEED_MPS),
    )


def from_run(run: Measurement, k: int, sheet: DataSheet) -> Shot:
    """Shot k of `lidar_emu.simulate`: the same values without a link."""
    return Shot(
        int(run.time_ns[k, 0]),
        directions(run.beam_angle_deg[k], sheet.azimuth_deg),
        np.where(run.range_valid[k], run.range_m[k], np.nan),
        _stated(run.sigma_range_m[k], UNSTATED_SIGMA_RANGE_M),
        np.where(run.speed_valid[k], run.closing_speed_mps[k], np.nan),
        _stated(run.sigma_speed_mps[k], UNSTATED_SIGMA_SPEED_MPS),
    )


def _numbers(beams: Sequence[Mapping[str, Any]], name: str, flag: str | None = None) -> Array:
    values = [beam.get(name) if flag is None or beam[flag] else None for beam in beams]
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def _stated(sigma: Array, otherwise: float) -> Array:
    return np.where(sigma > 0, sigma, otherwise)
