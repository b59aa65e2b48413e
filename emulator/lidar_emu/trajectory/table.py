"""A trajectory from a table: curves through its columns."""

from __future__ import annotations

import numpy as np

from lidar_emu.errors import Finding
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.trajectory import AngleColumn, LengthColumn, QuaternionColumns, RateColumns, Table
from lidar_emu.trajectory.attitude import AttitudeCurve, EulerAttitude, QuaternionAttitude
from lidar_emu.trajectory.curve import LEVEL, Curve, Curves, hermite, through
from lidar_emu.trajectory.state import Gap, VehicleState
from lidar_emu.trajectory.table_rows import FlownRows, read_flown

M_PER_UNIT = {"m": 1.0, "km": 1e3, "ft": 0.3048}
MPS_PER_UNIT = {"m/s": 1.0, "km/s": 1e3, "km/h": 1 / 3.6, "ft/s": 0.3048}
RAD_PER_UNIT = {"deg": np.pi / 180, "rad": 1.0}
RADPS_PER_UNIT = {"deg/s": np.pi / 180, "rad/s": 1.0}
QUATERNION_TOLERANCE = 1e-3


class TableTrajectory:
    """Curves of position, attitude and, where the table has them, body rates."""

    def __init__(self, part: Table) -> None:
        rows = read_flown(part)
        self._coordinates = Curves(
            [_coordinate(rows, column) or LEVEL for column in (part.east, part.north, part.up)]
        )
        self._attitude = _attitude(rows, part)
        self._body_rates = None if part.body_rates is None else _body_rates(rows, part.body_rates)
        self.duration_s = rows.duration_s
        self.gaps: tuple[Gap, ...] = tuple(sorted(rows.gaps, key=lambda gap: -gap.length_s))
        self.bridged: tuple[Gap, ...] = tuple(sorted(rows.bridged, key=lambda gap: gap.start_s))

    def state(self, time_s: FloatArray) -> VehicleState:
        position_m, velocity_mps, acceleration_mps2 = self._coordinates.at(time_s)
        site_from_body, body_rate_radps, angular_acceleration_radps2 = self._attitude.at(time_s)
        if self._body_rates is not None:
            body_rate_radps, angular_acceleration_radps2, _ = self._body_rates.at(time_s)
        return VehicleState(
            time_s=time_s,
            position_site_m=position_m,
            velocity_site_mps=velocity_mps,
            acceleration_site_mps2=acceleration_mps2,
            site_from_body=site_from_body,
            body_rate_radps=body_rate_radps,
            angular_acceleration_body_radps2=angular_acceleration_radps2,
        )


def _coordinate(rows: FlownRows, column: LengthColumn | None) -> Curve | None:
    """Position in metres over time in seconds; with a rate column, through the rows that have both."""
    if column is None:
        return None
    unit_m = M_PER_UNIT[column.unit]
    if column.rate_column is None or column.rate_unit is None:
        _, knot_s, (length,) = rows.filled(column.column)
        return through(knot_s, unit_m * length)
    _, knot_s, (length, rate) = rows.filled(column.column, column.rate_column)
    return hermite(knot_s, unit_m * length, MPS_PER_UNIT[column.rate_unit] * rate)


def _attitude(rows: FlownRows, part: Table) -> AttitudeCurve:
    if part.quaternion is not None:
        return _quaternions(rows, part.quaternion)
    return EulerAttitude(*(_angle(rows, column) for column in (part.yaw, part.pitch, part.roll)))


def _angle(rows: FlownRows, column: AngleColumn | None) -> Curve | None:
    """Angle in radians over time in seconds, unwrapped."""
    if column is None:
        return None
    _, knot_s, (angle,) = rows.filled(column.column)
    return through(knot_s, np.unwrap(column.sign * RAD_PER_UNIT[column.unit] * angle))


def _quaternions(rows: FlownRows, part: QuaternionColumns) -> QuaternionAttitude:
    row, knot_s, components = rows.filled(*part.columns)
    length = np.sqrt(np.sum(components**2, axis=0))
    wrong = np.flatnonzero(np.abs(length - 1) > QUATERNION_TOLERANCE)
    if wrong.size:
        found = Finding(f"a quaternion of length {length[wrong[0]]:.6g}")
        remedy = f"state unit quaternions, within {QUATERNION_TOLERANCE:g}"
        raise rows.csv.refusal(row[wrong[0]], " ".join(part.columns), found, remedy)
    return QuaternionAttitude(knot_s, (components / length).T)


def _body_rates(rows: FlownRows, part: RateColumns) -> Curves:
    """Body rates in rad/s about x, y and z, each column over its own filled rows."""
    filled = [rows.filled(name) for name in part.columns]
    return Curves([through(one.knot_s, RADPS_PER_UNIT[part.unit] * one.values[0]) for one in filled])
