"""Engine and attitude control between two commands, in closed form.

Commands are held and lags are of first order: thrust and torque are exponentials of the time since the command, and the
propellant used is an integral of thrust. None of them is integrated in steps: no lag, however short, makes the motion
stiff, and the rocket equation holds to rounding.
"""

from __future__ import annotations

from math import exp, expm1
from typing import NamedTuple

from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import Vector


class Lags(NamedTuple):
    """Time constants, and the engine's exhaust speed."""

    valve_s: float
    torque_s: float
    exhaust_mps: float


class ActuatorState(NamedTuple):
    """State of the actuators at a command: their values at its instant, and the commanded ones."""

    thrust_n: float
    mass_kg: float
    torque_nm: Vector
    thrust_command_n: float
    torque_command_nm: Vector


@kernel
def remaining_share(since_s: float, lag_s: float) -> float:
    """Fraction of a commanded change that remains."""
    return exp(-since_s / lag_s) if lag_s > 0.0 else 0.0


@kernel
def thrust_after(actuators: ActuatorState, lags: Lags, since_s: float) -> float:
    """Thrust in newtons, at a time since the command."""
    change_n = actuators.thrust_n - actuators.thrust_command_n
    return actuators.thrust_command_n + change_n * remaining_share(since_s, lags.valve_s)


@kernel
def mass_after(actuators: ActuatorState, lags: Lags, since_s: float) -> float:
    """Mass in kilograms: mass at the command less impulse over exhaust speed."""
    impulse_ns = actuators.thrust_command_n * since_s
    if lags.valve_s > 0.0:
        change_n = actuators.thrust_n - actuators.thrust_command_n
        impulse_ns -= change_n * lags.valve_s * expm1(-since_s / lags.valve_s)
    return actuators.mass_kg - impulse_ns / lags.exhaust_mps


@kernel
def torque_after(actuators: ActuatorState, lags: Lags, since_s: float) -> Vector:
    """Torque about the body's axes in newton metres."""
    now, to, missing = (
        actuators.torque_nm,
        actuators.torque_command_nm,
        remaining_share(since_s, lags.torque_s),
    )
    return (
        to[0] + (now[0] - to[0]) * missing,
        to[1] + (now[1] - to[1]) * missing,
        to[2] + (now[2] - to[2]) * missing,
    )


@kernel
def with_command(
    actuators: ActuatorState, lags: Lags, since_s: float, thrust_n: float, torque_nm: Vector
) -> ActuatorState:
    """State of the actuators at a new command, given at a time since the last."""
    return ActuatorState(
        thrust_after(actuators, lags, since_s),
        mass_after(actuators, lags, since_s),
        torque_after(actuators, lags, since_s),
        thrust_n,
        torque_nm,
    )
