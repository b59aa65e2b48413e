"""The measurement of a run beside the ground truth: arrays shaped (shots, beams).

Each column is declared once, here or in `lidar_emu.receiver.returns.BeamReport`; tables, recordings, packets and
docs/columns.md follow from the declarations.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.files import check_extra
from lidar_emu.numerics.arrays import (
    BoolArray,
    Column,
    FloatArray,
    Group,
    IntArray,
    columns,
    in_groups,
    missing_columns,
)
from lidar_emu.receiver.returns import BeamReport, FalseTarget, Reason

if TYPE_CHECKING:
    import pandas as pd


def _vector(
    group: Group, unit: str, meaning: str, in_table: str, axes: tuple[str, ...] = ("east", "north", "up")
) -> Column:
    per_shot = group is Group.VEHICLE
    return Column("f8", unit, meaning, group, (len(axes),), per_shot, in_table=in_table, axes=axes)


class GroundTruth(NamedTuple):
    """The ground truth of a measurement: arrays of shots and beams in SI units, NaN where nothing is known.

    The site frame has its axes east, north and up, from the site's origin; the body frame is x forward, y right,
    z down. The vehicle's arrays hold at the first beam's time of validity, the beams' at their own.
    """

    position_site_m: FloatArray
    """(shots, 3) Position of the vehicle's reference point."""
    velocity_site_mps: FloatArray
    """(shots, 3) Velocity of the vehicle."""
    acceleration_site_mps2: FloatArray
    """(shots, 3) Acceleration of the vehicle, the rate of its velocity."""
    site_from_body: FloatArray
    """(shots, 4) Attitude: unit quaternion w, x, y, z (Hamilton) that turns body vectors to the site frame, w >= 0."""
    body_rate_radps: FloatArray
    """(shots, 3) Angular rate of the body against the site, about body x, y, z."""
    range_m: FloatArray
    """(shots, beams) Range along the true beam axis; NaN where it hits nothing."""
    closing_speed_mps: FloatArray
    """(shots, beams) Closing speed of the sensor along the true beam axis, positive toward the ground."""
    incidence_deg: FloatArray
    """(shots, beams) Angle between the true beam axis and the ground's normal."""
    point_site_m: FloatArray
    """(shots, beams, 3) Hit point of the true beam axis."""
    object: NDArray[np.int16]
    """(shots, beams) What is hit: 0 the ground, 1, 2, ... the site's objects in order, -1 nothing."""
    sensor_site_m: FloatArray
    """(shots, beams, 3) Position of the sensor's aperture."""
    beam_axis_site: FloatArray
    """(shots, beams, 3) Unit vector along the true beam axis, with its misalignment."""


@dataclass(frozen=True, kw_only=True, repr=False)
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
    pattern: Annotated[
        NDArray[np.uint8],
        Column(
            "u1", "", "Number of the beam pattern in the scanner's list, from 0.", Group.TIMING, per_shot=True
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
            "Source of a peak that is not the surface's, a code of `lidar_emu.receiver.returns.FalseTarget`: "
            + ", ".join(f"{each.value} {each.name.lower().replace('_', ' ')}" for each in FalseTarget)
            + ".",
            Group.TRUTH,
        ),
    ]
    true_object: Annotated[
        NDArray[np.int16],
        Column(
            "i2",
            "",
            "What the true beam axis hits: 0 the ground, 1, 2, ... the site's objects in order, -1 nothing.",
            Group.TRUTH,
            missing=-1,  # `lidar_emu.scene.ray_hits.NOTHING`: a bench pattern does not load the scene
        ),
    ]
    true_point_site_m: Annotated[
        FloatArray, _vector(Group.TRUTH, "m", "True hit point of the true beam axis.", "true_point_{}_m")
    ]
    true_sensor_site_m: Annotated[
        FloatArray, _vector(Group.TRUTH, "m", "True position of the sensor's aperture.", "true_sensor_{}_m")
    ]
    """At the beam's time of validity."""
    true_beam_axis_site: Annotated[
        FloatArray,
        _vector(Group.TRUTH, "", "True beam axis, a unit vector from the sensor.", "true_beam_axis_{}"),
    ]
    beam_axis_body: Annotated[
        FloatArray,
        _vector(Group.POINT, "", "Published beam axis, a unit vector.", "beam_axis_body_{}", ("x", "y", "z")),
    ]
    """In the body frame, as a host knows it: without misalignment."""
    point_site_m: Annotated[
        FloatArray,
        _vector(Group.POINT, "m", "End of the measured range along the published beam axis.", "point_{}_m"),
    ]
    position_site_m: Annotated[
        FloatArray, _vector(Group.VEHICLE, "m", "True position of the vehicle.", "position_{}_m")
    ]
    """At the first beam's time of validity, like the following."""
    velocity_site_mps: Annotated[
        FloatArray, _vector(Group.VEHICLE, "m/s", "True velocity of the vehicle.", "velocity_{}_mps")
    ]
    acceleration_site_mps2: Annotated[
        FloatArray,
        _vector(Group.VEHICLE, "m/s²", "True acceleration of the vehicle.", "acceleration_{}_mps2"),
    ]
    site_from_body: Annotated[
        FloatArray,
        _vector(
            Group.VEHICLE,
            "",
            "True attitude of the vehicle: unit quaternion that turns body vectors to the site frame, w >= 0.",
            "site_from_body_{}",
            ("w", "x", "y", "z"),
        ),
    ]
    body_rate_radps: Annotated[
        FloatArray,
        _vector(
            Group.VEHICLE,
            "rad/s",
            "True angular rate of the vehicle against the site, about its body axes.",
            "body_rate_{}_radps",
            ("x", "y", "z"),
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
    def truth(self) -> GroundTruth:
        """The ground truth of vehicle and beams."""
        own = {name: getattr(self, name) for name in in_groups(COLUMNS, Group.VEHICLE)}
        return GroundTruth(
            **own, **{name: getattr(self, f"true_{name}") for name in GroundTruth._fields if name not in own}
        )

    @property
    def reason_name(self) -> NDArray[np.str_]:
        """(shots, beams) Name of `Reason` of each beam, e.g. `VALID`; `reason` holds its codes."""
        return _REASON_NAMES[self.reason]

    @property
    def beam_count(self) -> int:
        """Number of beams per shot, including beams that did not fire."""
        return int(self.fired.shape[1])

    def __len__(self) -> int:
        return len(self.shot)

    def __repr__(self) -> str:
        return f"<Measurement: {', '.join(f'{what} {value}' for what, value in self._summary().items())}>"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><th style='text-align:left'>{what}</th><td>{value}</td></tr>"
            for what, value in self._summary().items()
        )
        return f"<table><caption>Measurement</caption>{rows}</table>"

    def _summary(self) -> dict[str, str]:
        known_s = self.time_s[self.fired]
        codes, counts = np.unique(self.reason, return_counts=True)
        reasons = (
            f"{_REASON_NAMES[code]} {100 * count / self.reason.size:.3g} %"
            for code, count in zip(codes, counts, strict=True)
        )
        return {
            "shots": f"{len(self)}",
            "beams": f"{self.beam_count}",
            "time": f"{known_s.min():.6g} to {known_s.max():.6g} s" if known_s.size else "none",
            "reasons": ", ".join(reasons),
        }

    def to_pandas(self) -> pd.DataFrame:
        """Build a table with one row per shot and beam as a `pandas.DataFrame`.

        It has the columns of `table`, with `reason` as a categorical of the names of `Reason`.

        Raises:
            InputError: pandas is not installed.
        """
        check_extra("to_pandas", "a DataFrame", "pandas", "pandas")
        import pandas as pd

        reason = pd.Categorical.from_codes(self.reason.ravel(), categories=[each.name for each in Reason])
        return pd.DataFrame(self.table() | {"reason": reason})

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

    def table(self, names: Iterable[str] | None = None) -> dict[str, NDArray[np.generic]]:
        """Build a table with one row per shot and beam.

        Its columns are the columns of `simulate --out` and, except for the ground truth, the keys of `listen --json`.

        Args:
            names: names of the columns; None: all.
        """
        return {name: self._rows(name) for name in (TABLE if names is None else names)}

    def _rows(self, name: str) -> NDArray[np.generic]:
        shots, beams = self.fired.shape
        if name == "beam":
            return np.tile(np.arange(beams), shots)
        if name == "time_s":
            return self.time_s.ravel()
        array, component = IN_TABLE[name]
        values: NDArray[np.generic] = getattr(self, array)
        if component is not None:
            values = values[..., component]
        return np.repeat(values, beams) if COLUMNS[array].per_shot else values.ravel()


_REASON_NAMES = np.array([each.name for each in Reason])

COLUMNS = columns(Measurement)
"""All arrays of a measurement."""

TABLE = {
    **COLUMNS["shot"].in_rows("shot"),
    "beam": Column("i8", "", "Number of the beam, from 0.", Group.TIMING),
    "time_s": Column(
        "f8", "s", "Time of validity since the epoch; NaN: the beam did not fire.", Group.TIMING
    ),
    **COLUMNS["pattern"].in_rows("pattern"),
    **{
        row: declared
        for name, column in in_groups(
            COLUMNS, Group.POINTING, Group.REPORT, Group.TRUTH, Group.POINT, Group.VEHICLE
        ).items()
        for row, declared in column.in_rows(name).items()
    },
}
"""The columns of a table, in order."""

IN_TABLE: dict[str, tuple[str, int | None]] = {
    row: (name, place if column.components else None)
    for name, column in COLUMNS.items()
    for place, row in enumerate(column.in_rows(name))
}
"""The array, and the component of it, that each column of a table holds."""
