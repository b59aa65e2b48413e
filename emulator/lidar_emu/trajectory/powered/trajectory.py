"""A powered descent, solved before the run and interpolated at any instant.

Within a step, velocity and the derivative of the quaternion are cubics through their values and derivatives at its
ends, so that acceleration and rates follow the equations of motion; position and quaternion are their integrals from
the start of the step. Differences of positions, which a very short step before an event would magnify, are not formed.
The error is of fourth order in the step, like the integration's.
"""

from __future__ import annotations

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vector_arrays import from_quaternions
from lidar_emu.scenario.trajectory import PoweredDescent
from lidar_emu.trajectory.curve import piece_at
from lidar_emu.trajectory.powered.integration import StepHistory
from lidar_emu.trajectory.powered.solution import fly_descent
from lidar_emu.trajectory.powered.vehicle import ATTITUDE, POSITION
from lidar_emu.trajectory.state import Gap, VehicleState

COORDINATES = 7
"""Position and quaternion."""
ORDERS = 5


class DescentTrajectory:
    """The whole flight as a polynomial per step."""

    gaps: tuple[Gap, ...] = ()
    bridged: tuple[Gap, ...] = ()

    def __init__(self, part: PoweredDescent, body_radius_m: float) -> None:
        self.outcome, self.record = fly_descent(part, body_radius_m)
        self.duration_s = self.outcome.end_s
        mass_kg = self.record.mass_and_thrust[:, 0]
        self.propellant_kg = float(mass_kg[0] - mass_kg[-1])
        """Propellant burnt in the whole flight."""
        self._start_s, self._pieces = self.record.time_s, polynomials(self.record)

    def state(self, time_s: FloatArray) -> VehicleState:
        """State of the vehicle at scenario times (n,); after the end, it continues with the last acceleration."""
        orders = np.empty((3, len(time_s), COORDINATES))
        _read(self._start_s, self._pieces, time_s, orders)
        position_m, velocity_mps, acceleration_mps2 = np.ascontiguousarray(orders[:, :, :3])
        return VehicleState(
            time_s, position_m, velocity_mps, acceleration_mps2, *from_quaternions(orders[:, :, 3:])
        )


def polynomials(record: StepHistory) -> FloatArray:
    """Coefficients (steps + 1, 5, 7) of the powers 0 to 4 of the time since each step's start; the last polynomial
    continues the motion after the end."""
    pieces = np.zeros((len(record.time_s), ORDERS, COORDINATES))
    pieces[:, 0, :3] = record.state[:, POSITION : POSITION + 3]
    pieces[:, 0, 3:] = record.state[:, ATTITUDE : ATTITUDE + 4]
    step_s = np.diff(record.time_s)[:, None]
    (first, second), (first_end, second_end) = _by_order(record.start), _by_order(record.end)
    slope = (first_end - first) / step_s
    pieces[:-1, 1], pieces[:-1, 2] = first, second / 2
    pieces[:-1, 3] = (3 * slope - 2 * second - second_end) / step_s / 3
    pieces[:-1, 4] = (second + second_end - 2 * slope) / step_s**2 / 4
    pieces[-1, 1], pieces[-1, 2] = first_end[-1], second_end[-1] / 2
    return pieces


def _by_order(slope: FloatArray) -> tuple[FloatArray, FloatArray]:
    return slope[:, :COORDINATES], slope[:, COORDINATES:]


@kernel(outermost=True)
def _read(start_s: FloatArray, pieces: FloatArray, time_s: FloatArray, orders: FloatArray) -> None:
    for k in range(len(time_s)):
        place = piece_at(start_s, time_s[k])
        since_s, power = time_s[k] - start_s[place], pieces[place]
        for i in range(COORDINATES):
            c1, c2, c3, c4 = power[1, i], power[2, i], power[3, i], power[4, i]
            orders[0, k, i] = power[0, i] + since_s * (c1 + since_s * (c2 + since_s * (c3 + since_s * c4)))
            orders[1, k, i] = c1 + since_s * (2 * c2 + since_s * (3 * c3 + since_s * 4 * c4))
            orders[2, k, i] = 2 * c2 + since_s * (6 * c3 + since_s * 12 * c4)
