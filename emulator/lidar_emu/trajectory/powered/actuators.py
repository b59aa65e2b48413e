"""Engine and attitude control between two commands, in closed form.

Commands are held, lags are of first order: thrust and torque are exponentials of the time since the command, and the
propellant used is their integral. Nothing of it is integrated in steps, so that no lag, however short, makes the motion
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


class Acting(NamedTuple):
    """Actuators since a command: values at its instant, and commanded values."""

    thrust_n: float
    mass_kg: float
    torque_nm: Vector
    thrust_command_n: float
    torque_command_nm: Vector


@kernel
def still_missing(since_s: float, lag_s: float) -> float:
    """Share of a commanded change that is yet to come."""
    return exp(-since_s / lag_s) if lag_s > 0.0 else 0.0


@kernel
def thrust_after(acting: Acting, lags: Lags, since_s: float) -> float:
    """Thrust in newtons."""
    change_n = acting.thrust_n - acting.thrust_command_n
    return acting.thrust_command_n + change_n * still_missing(since_s, lags.valve_s)


@kernel
def mass_after(acting: Acting, lags: Lags, since_s: float) -> float:
    """Mass in kilograms: what was there less the impulse over the exhaust speed."""
    impulse_ns = acting.thrust_command_n * since_s
    if lags.valve_s > 0.0:
        change_n = acting.thrust_n - acting.thrust_command_n
        impulse_ns -= change_n * lags.valve_s * expm1(-since_s / lags.valve_s)
    return acting.mass_kg - impulse_ns / lags.exhaust_mps


@kernel
def torque_after(acting: Acting, lags: Lags, since_s: float) -> Vector:
    """Torque about the body's axes in newton metres."""
    now, to, missing = acting.torque_nm, acting.torque_command_nm, still_missing(since_s, lags.torque_s)
    return (
        to[0] + (now[0] - to[0]) * missing,
        to[1] + (now[1] - to[1]) * missing,
        to[2] + (now[2] - to[2]) * missing,
    )


@kernel
def commanded(acting: Acting, lags: Lags, since_s: float, thrust_n: float, torque_nm: Vector) -> Acting:
    """The same actuators from a new command on, given some time after the last."""
    return Acting(
        thrust_after(acting, lags, since_s),
        mass_after(acting, lags, since_s),
        torque_after(acting, lags, since_s),
        thrust_n,
        torque_nm,
    )
