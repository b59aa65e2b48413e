"""A lander for the tests, and means to look at one that is free of guidance."""

from __future__ import annotations

import json
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lidar_emu.scenario.trajectory import PoweredDescent
from lidar_emu.trajectory.powered.dynamics import (
    SIZE,
    ActuatorState,
    Lags,
    VehicleConstants,
    vehicle_constants,
)
from lidar_emu.trajectory.powered.integration import runge_kutta_step, set_slope

Floats = NDArray[np.float64]
RIGID: dict[str, Any] = {
    "mass_kg": 1500,
    "dry_mass_kg": 900,
    "inertia_kgm2": [1100, 1300, 900],
    "engine": {"maximum_thrust_n": 5500},
}
EXHAUST_MPS = 310 * 9.80665
NONE = (0.0, 0.0, 0.0)


def descent(vehicle: dict[str, Any] | None = None, **keys: Any) -> PoweredDescent:
    tree = {
        "kind": "powered_descent",
        "vehicle": RIGID | (vehicle or {}),
        "start": {"position_site_m": [100, -300, 500], "velocity_site_mps": [0, 15, -20]},
        "guidance": {"kind": "polynomial"},
        **keys,
    }
    return PoweredDescent.model_validate_json(json.dumps(tree))


def body(
    gravity_mps2: float = 0.0, ground_m: float = -1e9, radius_m: float = np.inf, **vehicle: Any
) -> VehicleConstants:
    return vehicle_constants(descent(vehicle).vehicle, gravity_mps2, radius_m, ground_m)


def at_rest(turn: Rotation | None = None) -> Floats:
    """At the origin, with attitude `turn` (site_from_body)."""
    state = np.zeros(SIZE)
    turn = turn or Rotation.identity()
    state[6:10] = np.roll(turn.as_quat(), 1)
    return state


def coast(
    of: VehicleConstants,
    state: Floats,
    duration_s: float,
    steps: int,
    thrust_n: float = 0.0,
    kg: float = 1500.0,
) -> Floats:
    """States (steps + 1, 13) without control, at constant thrust and mass."""
    actuators, lags = ActuatorState(thrust_n, kg, NONE, thrust_n, NONE), Lags(0.0, 0.0, np.inf)
    slopes, path = np.empty((4, SIZE)), np.empty((steps + 1, SIZE))
    path[0] = state
    for k in range(steps):
        set_slope(of, lags, actuators, 0.0, path[k], slopes[0])
        runge_kutta_step(of, lags, actuators, 0.0, duration_s / steps, path[k], slopes, path[k + 1])
    return path


class Sums(NamedTuple):
    """Sums for each state; no gravity."""

    momentum: Floats
    angular_momentum: Floats
    energy: Floats


def sums(of: VehicleConstants, path: Floats, kg: float = 1500.0) -> Sums:
    """Written anew from the definitions, with scipy's rotations."""
    turn = Rotation.from_quat(np.roll(path[:, 6:10], -1, axis=1))
    rate, inertia = path[:, 10:13], np.array(of.inertia_kgm2) * kg / of.start_kg
    momentum = kg * path[:, 3:6]
    energy = kg * np.sum(path[:, 3:6] ** 2, axis=1) + np.sum(inertia * rate**2, axis=1)
    return Sums(momentum, turn.apply(inertia * rate) + np.cross(path[:, :3], momentum), energy / 2)
