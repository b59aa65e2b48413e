"""Steps of the classical Runge-Kutta method, aligned with commands and events.

The steps after a command begin at a quarter of the shortest lag and grow with the time since the command, so that they
resolve the exponentials of `actuators` for any lag.
"""

from __future__ import annotations

from typing import NamedTuple

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.trajectory.powered.actuators import ActuatorState, Lags, mass_after, thrust_after, torque_after
from lidar_emu.trajectory.powered.contact import lowest_foot_m
from lidar_emu.trajectory.powered.motion import set_derivative
from lidar_emu.trajectory.powered.vehicle import SIZE, VehicleConstants

BISECTIONS = 52
"""Bisections of a step in the search for an event: down to the last bit."""


class StepSizes(NamedTuple):
    """Lengths of steps."""

    first_s: float
    """First step after a command."""
    growth: float
    """Largest next step, as a fraction of the time since the command."""
    longest_s: float
    standing_s: float
    """Longest step on the ground."""


@kernel
def next_step_s(step_sizes: StepSizes, longest_s: float, since_s: float, remaining_s: float) -> float:
    """Length of the next step; the last two before the end of an interval have equal lengths."""
    step_s = min(longest_s, max(step_sizes.first_s, step_sizes.growth * since_s))
    if step_s >= remaining_s:
        return remaining_s
    return min(step_s, 0.5 * remaining_s) if 2.0 * step_s > remaining_s else step_s


@kernel
def set_slope(
    body: VehicleConstants,
    lags: Lags,
    actuators: ActuatorState,
    since_s: float,
    state: FloatArray,
    slope: FloatArray,
) -> None:
    """Set the derivative of a state at a time since the last command."""
    mass_kg, thrust_n = mass_after(actuators, lags, since_s), thrust_after(actuators, lags, since_s)
    set_derivative(body, mass_kg, thrust_n, torque_after(actuators, lags, since_s), state, slope)


@kernel
def runge_kutta_step(
    body: VehicleConstants,
    lags: Lags,
    actuators: ActuatorState,
    since_s: float,
    step_s: float,
    state: FloatArray,
    slopes: FloatArray,
    stepped: FloatArray,
) -> None:
    """Set the state (13,) one step later; `slopes` (4, 13) holds the slope at the present state in its first row."""
    half_s = 0.5 * step_s
    add_scaled(state, half_s, slopes[0], stepped)
    set_slope(body, lags, actuators, since_s + half_s, stepped, slopes[1])
    add_scaled(state, half_s, slopes[1], stepped)
    set_slope(body, lags, actuators, since_s + half_s, stepped, slopes[2])
    add_scaled(state, step_s, slopes[2], stepped)
    set_slope(body, lags, actuators, since_s + step_s, stepped, slopes[3])
    for i in range(SIZE):
        mean = (slopes[0, i] + 2.0 * (slopes[1, i] + slopes[2, i]) + slopes[3, i]) / 6.0
        stepped[i] = state[i] + step_s * mean


@kernel
def add_scaled(state: FloatArray, by_s: float, slope: FloatArray, moved: FloatArray) -> None:
    for i in range(SIZE):
        moved[i] = state[i] + by_s * slope[i]


@kernel
def step_to_height(
    body: VehicleConstants,
    lags: Lags,
    actuators: ActuatorState,
    since_s: float,
    step_s: float,
    height_m: float,
    state: FloatArray,
    slopes: FloatArray,
    stepped: FloatArray,
) -> float:
    """Length of the step at whose end the lowest foot reaches a height, given a step that ends below it.

    Each trial is a step of its own length from the same state, so that the event has the accuracy of the method.
    """
    above_s, below_s = 0.0, step_s
    for _ in range(BISECTIONS):
        middle_s = 0.5 * (above_s + below_s)
        runge_kutta_step(body, lags, actuators, since_s, middle_s, state, slopes, stepped)
        if lowest_foot_m(body, stepped) > height_m:
            above_s = middle_s
        else:
            below_s = middle_s
    runge_kutta_step(body, lags, actuators, since_s, below_s, state, slopes, stepped)
    return below_s
