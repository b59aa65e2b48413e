"""Update the table of docs/evidence/flights.md: error and run time of a powered descent, compared with scipy's solvers.

python tools/descent_solvers.py            rewrites the table between the two markers; about three minutes
python tools/descent_solvers.py --print    prints it

Ten seconds of the shipped powered descent with its slosh and bending mode, control at 100 Hz. scipy's solvers
integrate the same compiled equations of motion with thrust, mass and torque as five additional states, and restart at
every command, where the derivatives jump.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

import lidar_emu
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import vector_at
from lidar_emu.trajectory.powered.actuators import ActuatorState, Lags
from lidar_emu.trajectory.powered.control import attitude_torque, specific_thrust_at, throttle
from lidar_emu.trajectory.powered.motion import gravity_at, inertia_at, set_derivative
from lidar_emu.trajectory.powered.solution import Descent, prepare, solve
from lidar_emu.trajectory.powered.steps import StepSizes
from lidar_emu.trajectory.powered.vehicle import POSITION, SIZE, VELOCITY, VehicleConstants

PAGE = Path(__file__).resolve().parents[1] / "docs" / "evidence" / "flights.md"
BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"
DURATION_S, CONTROL_HZ = 10.0, 100
VALVE_LAGS_S = (1e-3, 5e-5)
STEP_FACTORS = (1, 2, 4, 8)
"""Factors by which the scenario's step sizes are divided."""
SOLVERS = (
    ("RK45", 1e-6),
    ("RK45", 1e-9),
    ("DOP853", 1e-9),
    ("DOP853", 1e-13),
    ("LSODA", 1e-6),
    ("LSODA", 1e-9),
    ("Radau", 1e-6),
    ("Radau", 1e-9),
    ("BDF", 1e-6),
)
THRUST, MASS, TORQUE = SIZE, SIZE + 1, SIZE + 2


class MethodResult(NamedTuple):
    """Run time and result of one method of integration."""

    name: str
    ms_per_s: float
    states: FloatArray
    """(ticks, 21) States at the control ticks; see `lidar_emu.trajectory.powered.vehicle`."""


def measure(lag_s: float) -> list[tuple[str, float, float, float]]:
    """Name, ms per simulated second, largest velocity (m/s) and position (m) errors at the ticks, for every method."""
    flight = prepare_descent(lag_s)
    reference = measure_own(flight, 16).states
    methods = [measure_own(flight, factor) for factor in STEP_FACTORS]
    methods += [measure_scipy(flight, *solver) for solver in SOLVERS]
    return [(method.name, method.ms_per_s, *errors(method.states, reference)) for method in methods]


def prepare_descent(lag_s: float) -> Descent:
    """The shipped powered descent with this lag of the engine's valve."""
    settings = {
        "trajectory.control_rate_hz": str(CONTROL_HZ),
        "trajectory.vehicle.engine.valve_lag_s": str(lag_s),
        "trajectory.longest_s": str(DURATION_S),
    }
    scenario: Any = lidar_emu.load("powered_descent.yaml", settings)
    return prepare(scenario.trajectory, scenario.site.body.radius_m)


def measure_own(flight: Descent, factor: float) -> MethodResult:
    """Fly with the emulator's solver, its step sizes divided by `factor`."""
    first, growth, longest, standing = flight.step_sizes
    step_sizes = StepSizes(first / factor, growth / factor, longest / factor, standing / factor)
    record, taken_s = timed(lambda: solve(flight._replace(step_sizes=step_sizes))[1], 5)
    ticks = np.arange(1, round(DURATION_S * CONTROL_HZ) + 1) / CONTROL_HZ
    rows = np.searchsorted(record.time_s, ticks - 1e-9)
    name = f"lidar-emu, steps up to {1e3 * longest / factor:g} ms"
    return MethodResult(name, 1e3 * taken_s / DURATION_S, record.state[rows])


@kernel(outermost=True)
def set_slope_with_lags(
    body: VehicleConstants,
    lags: Lags,
    actuators: ActuatorState,
    y: FloatArray,
    state: FloatArray,
    slope: FloatArray,
) -> None:
    """Derivative of the states with thrust, mass and torque; `state` is a buffer for the first 21."""
    for i in range(SIZE):
        state[i] = y[i]
    set_derivative(body, y[MASS], y[THRUST], vector_at(y, TORQUE), state, slope)
    slope[THRUST] = (actuators.thrust_command_n - y[THRUST]) / lags.valve_s
    slope[MASS] = -y[THRUST] / lags.exhaust_mps
    for i in range(3):
        slope[TORQUE + i] = (actuators.torque_command_nm[i] - y[TORQUE + i]) / lags.torque_s


def measure_scipy(flight: Descent, method: str, tolerance: float) -> MethodResult:
    """Fly with a solver of scipy."""
    states, taken_s = timed(lambda: solve_with_restarts(flight, method, tolerance), 1)
    name = f"scipy {method}, rtol {tolerance:.0e}"
    return MethodResult(name, 1e3 * taken_s / DURATION_S, states)


def solve_with_restarts(flight: Descent, method: str, tolerance: float) -> FloatArray:
    """(ticks, 21) States at the control ticks, by a solver of scipy that restarts at every tick."""
    body, lags, guide, actuators = flight.body, flight.lags, flight.guide, flight.actuators
    y = np.concatenate([flight.state, [actuators.thrust_n, actuators.mass_kg], actuators.torque_nm])
    states = np.empty((round(DURATION_S * CONTROL_HZ), SIZE))
    buffer = np.empty(SIZE)
    for tick in range(len(states)):
        state = y[:SIZE].copy()
        thrust_mps2 = specific_thrust_at(
            guide, tick / CONTROL_HZ, gravity_at(body, vector_at(state, POSITION)), state
        )
        command = ActuatorState(
            y[THRUST],
            y[MASS],
            vector_at(y, TORQUE),
            throttle(guide, y[MASS], thrust_mps2, state),
            attitude_torque(guide, inertia_at(body, y[MASS]), thrust_mps2, state),
        )

        def slope(_time_s: float, y: FloatArray, command: ActuatorState = command) -> FloatArray:
            out = np.empty(len(y))
            set_slope_with_lags(body, lags, command, y, buffer, out)
            return out

        span = tick / CONTROL_HZ, (tick + 1) / CONTROL_HZ
        y = np.ascontiguousarray(
            solve_ivp(slope, span, y, method=method, rtol=tolerance, atol=tolerance / 10).y[:, -1]
        )
        states[tick] = y[:SIZE]
    return states


def timed(job: Callable[[], Any], rounds: int) -> tuple[Any, float]:
    """The last result of a job, and the median of its times in seconds; the kernels must be compiled."""
    times = []
    for _ in range(rounds):
        start_s = perf_counter()
        result = job()
        times.append(perf_counter() - start_s)
    return result, float(np.median(times))


def errors(states: FloatArray, reference: FloatArray) -> tuple[float, float]:
    """Largest errors of velocity (m/s) and position (m) of states (ticks, 21)."""
    difference = np.abs(states - reference)
    velocity_mps, position_m = (difference[:, k : k + 3].max() for k in (VELOCITY, POSITION))
    return float(velocity_mps), float(position_m)


def table() -> str:
    """Measure all methods; the table as Markdown."""
    compiled = prepare_descent(1e-3)
    measure_own(compiled, 1)
    solve_with_restarts(compiled, "RK45", 1e-3)
    lines = [
        "| | valve 1 ms: ms per s | velocity m/s | position m | valve 0.05 ms: ms per s | velocity m/s | position m |",
        "|---|---|---|---|---|---|---|",
    ]
    for soft, stiff in zip(*(measure(lag_s) for lag_s in VALVE_LAGS_S), strict=True):
        cells = [f"{ms:.3g} | {speed:.0e} | {place:.0e}" for _, ms, speed, place in (soft, stiff)]
        lines.append(f"| {soft[0]} | {cells[0]} | {cells[1]} |")
    return "\n".join(lines)


if __name__ == "__main__":
    measured = table()
    if sys.argv[1:] == ["--print"]:
        print(measured)
    else:
        page = PAGE.read_text()
        before, after = page.split(BEGIN)[0], page.split(END)[1]
        PAGE.write_text(f"{before}{BEGIN}\n{measured}\n{END}{after}")
