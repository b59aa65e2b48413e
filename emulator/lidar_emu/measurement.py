"""The measurement of a run beside the ground truth: arrays shaped (shots, beams).

Each column is declared once, here or in `lidar_emu.fmcw.returns.BeamReport`; tables, recordings, packets and
docs/columns.md follow from the declarations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.fmcw.reasons import FalseTarget
from lidar_emu.fmcw.returns import BeamReport
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.numerics.columns import Column, Group, columns, in_groups, missing_columns


@dataclass(frozen=True, kw_only=True)
class Measurement(BeamReport):
    """Shots of all beams in SI units; NaN where a beam did not fire or a value is missing.

    Arrays are shaped (shots, beams), (shots,) where `per_shot` is set, with 3 components last where these are given.
    """

    shot: Annotated[
        IntArray,
        Column(
            "i8", "", "Number of the shot, from 0, before faults of the counter.", Group.TIMING, per_shot=True
        ),
    ]
    time_ns: Annotated[
        IntArray,
        Column(
            "i8", "ns", "Time of validity since the epoch, also of beams that did not fire.", Group.TIMING
        ),
    ]
    """Centre of the constant segment's record; for a bench pattern, the start of the shot."""
    due_ns: Annotated[
        IntArray,
        Column(
            "i8", "ns", "Due time of the packet since the epoch, without faults.", Group.TIMING, per_shot=True
        ),
    ]
    fired: Annotated[BoolArray, Column("?", "", "Whether the beam fired.", Group.POINTING)]
    beam_angle_deg: Annotated[
        FloatArray, Column("f8", "deg", "Published off-boresight angle.", Group.POINTING)
    ]
    true_range_m: Annotated[
        FloatArray,
        Column("f8", "m", "True range along the true beam axis; NaN: no ground there.", Group.TRUTH),
    ]
    true_closing_speed_mps: Annotated[
        FloatArray,
        Column("f8", "m/s", "True closing speed of the sensor along the true beam axis.", Group.TRUTH),
    ]
    true_incidence_deg: Annotated[
        FloatArray,
        Column("f8", "deg", "Angle between the true beam axis and the ground's normal.", Group.TRUTH),
    ]
    true_in_gap: Annotated[
        BoolArray,
        Column("?", "", "Whether the truth bridges a gap in the table of the trajectory.", Group.TRUTH),
    ]
    true_peak_source: Annotated[
        NDArray[np.uint8],
        Column(
            "u1",
            "",
            "Source of a peak that is not the surface's, a code of `lidar_emu.fmcw.reasons.FalseTarget`: "
            + ", ".join(f"{each.value} {each.name.lower().replace('_', ' ')}" for each in FalseTarget)
            + ".",
            Group.TRUTH,
        ),
    ]
    point_site_m: Annotated[
        FloatArray,
        Column("f8", "m", "End of the measured range along the published beam axis.", Group.POINT, (3,)),
    ]
    position_site_m: Annotated[
        FloatArray,
        Column(
            "f8", "m", "True position of the vehicle: east, north, up.", Group.VEHICLE, (3,), per_shot=True
        ),
    ]
    """At the first beam's time of validity."""
    velocity_site_mps: Annotated[
        FloatArray,
        Column(
            "f8", "m/s", "True velocity of the vehicle: east, north, up.", Group.VEHICLE, (3,), per_shot=True
        ),
    ]

    @classmethod
    def with_columns(
        cls, shot: IntArray, time_ns: IntArray, due_ns: IntArray, **known: NDArray[Any]
    ) -> Measurement:
        """Build shots from some columns; the other columns have the value of a beam that did not fire."""
        known |= {"shot": shot, "time_ns": time_ns, "due_ns": due_ns}
        return cls(**missing_columns(COLUMNS, known, time_ns.shape), **known)

    @classmethod
    def concatenate(cls, blocks: Sequence[Measurement]) -> Measurement:
        """Join blocks of shots in order."""
        return cls(**{name: np.concatenate([getattr(block, name) for block in blocks]) for name in COLUMNS})

    @property
    def time_s(self) -> FloatArray:
        """Time of validity in seconds since the epoch; NaN where a beam did not fire."""
        return np.where(self.fired, self.time_ns * 1e-9, np.nan)

    @property
    def beam_count(self) -> int:
        """Number of beams per shot, including beams that did not fire."""
        return int(self.fired.shape[1])

    def __len__(self) -> int:
        return len(self.shot)

    def part(self, first: int, end: int) -> Measurement:
        """Select the shots in rows `first` to `end - 1`."""
        return Measurement(**{name: getattr(self, name)[first:end] for name in COLUMNS})

    def one(self, row: int) -> Measurement:
        """Select a single shot."""
        return self.part(row, row + 1)

    def firing_only(self, fires: BoolArray) -> Measurement:
        """Blank all beams but these, (shots, beams) or (1, beams), as not fired; the ground truth stays."""
        blank: dict[str, Any] = {}
        for name, column in in_groups(COLUMNS, Group.POINTING, Group.REPORT, Group.POINT).items():
            values = getattr(self, name)
            missing = np.asarray(column.missing_value, dtype=values.dtype)
            blank[name] = np.where(fires[..., None] if column.components else fires, values, missing)
        return replace(self, **blank)

    def table(self) -> dict[str, NDArray[np.generic]]:
        """Build a table with one row per shot and beam.

        Its columns are the columns of `simulate --out` and, except for the ground truth, the keys of `listen --json`.
        """
        shots, beams = self.fired.shape
        derived = {
            "shot": np.repeat(self.shot, beams),
            "beam": np.tile(np.arange(beams), shots),
            **{name: self.point_site_m[..., axis].ravel() for axis, name in enumerate(POINT_COLUMNS)},
        }
        return {name: derived[name] if name in derived else getattr(self, name).ravel() for name in TABLE}


COLUMNS = columns(Measurement)
"""All arrays of a measurement."""

POINT_COLUMNS = ("point_east_m", "point_north_m", "point_up_m")
"""The components of `point_site_m` in a table."""

TABLE = {
    "shot": replace(COLUMNS["shot"], per_shot=False),
    "beam": Column("i8", "", "Number of the beam, from 0.", Group.TIMING),
    "time_s": Column(
        "f8", "s", "Time of validity since the epoch; NaN: the beam did not fire.", Group.TIMING
    ),
    **in_groups(COLUMNS, Group.POINTING, Group.REPORT, Group.TRUTH),
    **{
        name: Column("f8", "m", f"End of the measured range: {axis}.", Group.POINT)
        for name, axis in zip(POINT_COLUMNS, ("east", "north", "up"), strict=True)
    },
}
"""The columns of a table, in order."""
