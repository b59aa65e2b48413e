"""What a run measured, beside the truth: arrays shaped (shots, beams)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.fmcw.reasons import Reason
from lidar_emu.numerics.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class Measurement:
    """Shots of all beams, in SI; NaN where a beam did not fire or a value is missing.

    Arrays are shaped (shots, beams) unless the shape stands beside them. Closing speed is positive toward the ground.
    """

    shot: NDArray[np.int64]
    """(shots,) Number of the shot, from 0."""
    time_ns: NDArray[np.int64]
    """Time of validity since the epoch: the centre of the constant segment's record; of a bench pattern the shot's
    start."""
    due_ns: NDArray[np.int64]
    """(shots,) When the packet is due, since the epoch."""
    fired: BoolArray
    beam_angle_deg: FloatArray
    """Published off-boresight angle."""
    range_m: FloatArray
    closing_speed_mps: FloatArray
    range_valid: BoolArray
    speed_valid: BoolArray
    sign_resolved: BoolArray
    reason: NDArray[np.int8]
    """Why a beam is invalid: a `lidar_emu.fmcw.reasons.Reason`."""
    segments: NDArray[np.uint8]
    """Segments in which the target was detected: bit 0 up-chirp, bit 1 constant, bit 2 down-chirp."""
    snr_db: FloatArray
    residual_mps: FloatArray
    """Disagreement of the three segments, as a speed."""
    sigma_range_m: FloatArray
    sigma_speed_mps: FloatArray
    returns: NDArray[np.uint8]
    second_range_m: FloatArray
    true_range_m: FloatArray
    """Along the true beam axis to the ground; NaN where there is none."""
    true_closing_speed_mps: FloatArray
    """Of the sensor along the true beam axis."""
    true_incidence_deg: FloatArray
    """Between the true beam axis and the ground's normal where they meet; NaN where they do not."""
    true_in_gap: BoolArray
    """The truth is bridged there: the table of the trajectory has a gap longer than it allows."""
    point_site_m: FloatArray
    """(shots, beams, 3) Measured point: the measured range along the published beam direction."""
    position_site_m: FloatArray
    """(shots, 3) True position of the vehicle at the first beam's time of validity."""
    velocity_site_mps: FloatArray
    """(shots, 3) True velocity of the vehicle."""

    @property
    def time_s(self) -> FloatArray:
        """Time of validity in seconds since the epoch; NaN where a beam did not fire."""
        return np.where(self.fired, self.time_ns * 1e-9, np.nan)

    @property
    def beam_count(self) -> int:
        """Beams of a shot, fired or not."""
        return int(self.fired.shape[1])

    def __len__(self) -> int:
        return len(self.shot)

    def part(self, first: int, end: int) -> Measurement:
        """Some of the shots: rows from `first`, and before `end`."""
        return self._rows(slice(first, end))

    def one(self, row: int) -> Measurement:
        """A single shot."""
        return self._rows(slice(row, row + 1))

    def firing_only(self, fires: BoolArray) -> Measurement:
        """The same shots as if only these beams had fired, (shots, beams) or (1, beams); the truth stays."""
        measured = [name for name in _TABLE_FIELDS if not name.startswith("true_")]
        blank: dict[str, Any] = {
            name: np.where(fires, values, np.asarray(_of_nothing(name, values), dtype=values.dtype))
            for name, values in ((name, getattr(self, name)) for name in measured)
        }
        blank["point_site_m"] = np.where(fires[..., None], self.point_site_m, np.nan)
        return replace(self, **blank)

    @classmethod
    def of_nothing(
        cls,
        shot: NDArray[np.int64],
        time_ns: NDArray[np.int64],
        due_ns: NDArray[np.int64],
        position_site_m: FloatArray,
        velocity_site_mps: FloatArray,
    ) -> Measurement:
        """Shots in which no beam fires, and nothing is known but where the vehicle is."""
        blank = {f.name: np.full(time_ns.shape, np.nan) for f in fields(cls) if f.name in _TABLE_FIELDS}
        blank |= {name: np.zeros(time_ns.shape, dtype=kind) for name, kind in _WHOLE.items()}
        blank["reason"] = np.full(time_ns.shape, Reason.NOT_FIRED, dtype=np.int8)
        nowhere = np.full((*time_ns.shape, 3), np.nan)
        where: dict[str, Any] = {
            "point_site_m": nowhere,
            "position_site_m": position_site_m,
            "velocity_site_mps": velocity_site_mps,
        }
        return cls(shot=shot, time_ns=time_ns, due_ns=due_ns, **blank, **where)

    def _rows(self, rows: slice) -> Measurement:
        return Measurement(*(getattr(self, f.name)[rows] for f in fields(self)))

    def table(self) -> dict[str, NDArray[np.generic]]:
        """One row per shot and beam: the columns of `simulate --out` and, truth aside, the keys of `listen --json`."""
        shape = self.fired.shape
        columns: dict[str, NDArray[np.generic]] = {
            "shot": np.repeat(self.shot, shape[1]),
            "beam": np.tile(np.arange(shape[1]), shape[0]),
            "time_s": self.time_s.ravel(),
        }
        for name in _TABLE_FIELDS:
            columns[name] = getattr(self, name).ravel()
        for axis, name in enumerate(("point_east_m", "point_north_m", "point_up_m")):
            columns[name] = self.point_site_m[..., axis].ravel()
        return columns

    @classmethod
    def joined(cls, blocks: Sequence[Measurement]) -> Measurement:
        """Blocks of shots, one after another."""
        return cls(*(np.concatenate([getattr(b, f.name) for b in blocks]) for f in fields(cls)))


_FLAGS = ("fired", "range_valid", "speed_valid", "sign_resolved", "true_in_gap")
_WHOLE = {**dict.fromkeys(_FLAGS, np.bool_), "segments": np.uint8, "returns": np.uint8}
"""What is no number with a fraction, but the reason."""


def _of_nothing(name: str, values: NDArray[Any]) -> float:
    """What stands where a beam did not fire."""
    if name == "reason":
        return Reason.NOT_FIRED
    return np.nan if values.dtype == np.float64 else 0


_TABLE_FIELDS = (
    "fired",
    "beam_angle_deg",
    "range_m",
    "closing_speed_mps",
    "range_valid",
    "speed_valid",
    "sign_resolved",
    "reason",
    "segments",
    "snr_db",
    "residual_mps",
    "sigma_range_m",
    "sigma_speed_mps",
    "returns",
    "second_range_m",
    "true_range_m",
    "true_closing_speed_mps",
    "true_incidence_deg",
    "true_in_gap",
)
