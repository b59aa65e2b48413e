"""Beam axes and the lever arm of a sensor, where its log has the true motion of the vehicle.

A sensor at r from the vehicle's reference point sees along the axis u the closing speed u·(v + ω x r), which is linear
in u and in m = r x u. Both are solved for each beam, and r by the m of all beams.
"""

from __future__ import annotations

import numpy as np

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.numerics.vector_arrays import cross
from lidar_emu.sensor_fit.characteristics import Row
from lidar_emu.sensor_fit.flight_log import MOTION, FlightLog
from lidar_emu.sensor_fit.noise_law import LEAST_BLOCKS, UNKNOWN, interval_of, resampled
from lidar_emu.sensor_fit.reference import Errors, huber_solution

_TELLS = {
    "beam axis": ("", 0.2, "the velocity varies too little in direction"),
    "lever arm": ("m", 5.0, "the vehicle turns too little"),
}
"""Unit, the width of an interval from which on the motion does not tell, and the word then."""
_ROUNDING = 1e-12


def body_motion(log: FlightLog) -> FloatArray:
    """(shots, beams, 6) Velocity of the vehicle and its rate of rotation, in body axes; NaN where unknown."""
    columns = np.stack([log.motion[key] for key in MOTION], axis=-1)
    velocity_site_mps, scalar, vector = columns[..., :3], columns[..., 3:4], columns[..., 4:7]
    across = cross(vector, velocity_site_mps)
    velocity_mps = velocity_site_mps - 2.0 * scalar * across + 2.0 * cross(vector, across)
    return np.concatenate([velocity_mps, columns[..., 7:]], axis=-1)


def axis_rows(log: FlightLog, errors: Errors, used: BoolArray) -> list[Row]:
    """Rows of the beams' axes and of the lever arm, by the shots that are `used`; none without the vehicle's motion."""
    motion = body_motion(log) if log.motion else np.full((1, 1, 6), np.nan)
    if not np.isfinite(motion).any():
        return []
    good = (
        used & np.isfinite(log.closing_speed_mps) & ~errors.speed.is_false & np.isfinite(motion).all(axis=-1)
    )
    names = np.unique(errors.block[good])
    if len(names) < LEAST_BLOCKS:
        return [Row("beam axes and lever arm", None, "", "", UNKNOWN, "too few blocks")]
    # The log first, then the replicates; all beams by the same blocks.
    counts = np.concatenate([np.ones((1, len(names))), resampled(names)[1]])
    rows, weight, pull = [], np.zeros((len(counts), 3, 3)), np.zeros((len(counts), 3))
    pattern = log.motion.get("pattern", np.zeros(good.shape))
    for number, beam in ((each, beam) for each in np.unique(pattern[good]) for beam in range(good.shape[1])):
        at = good[:, beam] & (pattern[:, beam] == number)
        place = np.searchsorted(names, errors.block[at, beam])
        information, solved = _by_replicate(motion[at, beam], log.closing_speed_mps[at, beam], place, counts)
        axis, moment = solved[:, :3], solved[:, 3:]
        which = f"pattern {number:.0f}" if "pattern" in log.motion else ""
        rows += _rows("beam axis", beam, which, axis, information[0], len(names))
        # What the moments say of the arm, without the directions about which the vehicle does not turn.
        about_axis, both = information[:, :3, :3], information[:, :3, 3:]
        said = (
            information[:, 3:, 3:]
            - _turned(both) @ np.linalg.pinv(about_axis, _ROUNDING, hermitian=True) @ both
        )
        by_arm = _turned(cross(np.eye(3)[None], axis[:, None]))
        weight += _turned(by_arm) @ said @ by_arm
        pull += (_turned(by_arm) @ said @ moment[..., None])[..., 0]
    arm_m = (np.linalg.pinv(weight, _ROUNDING, hermitian=True) @ pull[..., None])[..., 0]
    return rows + _rows("lever arm", None, "", arm_m, weight[0], len(names))


def _by_replicate(
    design: FloatArray, speed_mps: FloatArray, place: IntArray, counts: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Information (replicates, 6, 6), and axis and moment (replicates, 6), by Huber's weights."""
    solved, share = huber_solution(design, speed_mps)
    off = share * (speed_mps - design @ solved)
    # As for bias and scale: one step of Newton, and only values with full weight hold the solution in place.
    holds = (share == 1.0)[:, None, None] * design[:, :, None] * design[:, None]
    by_block = np.zeros((counts.shape[1], 6, 7))
    np.add.at(by_block, place, np.concatenate([holds, (off[:, None] * design)[..., None]], axis=2))
    sums = np.einsum("rb,bij->rij", counts, by_block)
    information = sums[:, :, :6]
    step = np.linalg.pinv(information, _ROUNDING, hermitian=True) @ sums[:, :, 6:]
    return information, solved + step[..., 0]


def _rows(
    what: str, beam: int | None, at: str, solved: FloatArray, information: FloatArray, blocks: int
) -> list[Row]:
    unit, widest, word = _TELLS[what]
    # Along what the motion does not show, the least solution is 0 with an interval of rounding.
    shown = np.diag(np.linalg.pinv(information, _ROUNDING, hermitian=True) @ information) > 0.999
    rows = []
    for place, axis in enumerate("xyz"):
        found = interval_of(float(solved[0, place]), solved[1:, place], blocks)
        tells = shown[place] and found.high - found.low <= widest
        rows.append(
            Row(f"{what}, body {axis}", beam, at, unit, found if tells else UNKNOWN, "" if tells else word)
        )
    return rows


def _turned(matrices: FloatArray) -> FloatArray:
    return np.swapaxes(matrices, -1, -2)
