"""A simulated inertial unit on the flight of a scenario: increments of angle and velocity, with errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import astuple, dataclass
from functools import partial
from math import ceil, exp, pi, sqrt
from typing import Any, NamedTuple

import numpy as np

from lidar_emu.beams.flight import build_trajectory, flown_s
from lidar_emu.errors import InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.random_streams import INERTIAL, generator
from lidar_emu.numerics.vector_arrays import rotate
from lidar_emu.numerics.vectors import to_quaternion
from lidar_emu.scenario.load import ScenarioSource, load, require_flight, require_known_flight
from lidar_emu.trajectory.profile import Trajectory

_DEGREE_PER_HOUR = pi / 180 / 3600
_DEGREE_PER_ROOT_HOUR = pi / 180 / 60
_MICRO_G = 9.80665e-6


@dataclass(frozen=True)
class ImuErrors:
    """Standard deviations of an inertial unit's errors, each axis by itself; 0 leaves one out.

    The terms are those of IEEE Std 952-1997, annex C. The instability of a bias is a Gauss-Markov process of first
    order, whose Allan deviation has its maximum, 0.618 times the deviation, at 1.89 times the correlation time.

    The defaults are a unit of landers and rovers: biases and random walks by the data sheet of Northrop Grumman's
    LN-200S, scale factors and instabilities as usual for units of this class.
    """

    gyro_bias_radps: float = 1.0 * _DEGREE_PER_HOUR
    """Constant bias."""
    gyro_instability_radps: float = 0.35 * _DEGREE_PER_HOUR
    gyro_correlation_s: float = 100.0
    angle_random_walk: float = 0.07 * _DEGREE_PER_ROOT_HOUR
    """White noise of the rate: rad per square root of s."""
    gyro_scale: float = 100e-6
    """Relative error of the scale factor."""
    accelerometer_bias_mps2: float = 300 * _MICRO_G
    """Constant bias."""
    accelerometer_instability_mps2: float = 50 * _MICRO_G
    accelerometer_correlation_s: float = 60.0
    velocity_random_walk: float = 35 * _MICRO_G
    """White noise of the specific force: m/s per square root of s."""
    accelerometer_scale: float = 300e-6
    """Relative error of the scale factor."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            least = 1e-6 if name.endswith("_correlation_s") else 0.0
            _number("ImuErrors", name, value, least, 1e6)


class ImuSamples(NamedTuple):
    """The output of a strapdown inertial unit at the vehicle's reference point, with its axes along the body's.

    The increments of row k are the integrals of the sensed rate and specific force (acceleration less gravity) over
    `time_s[k]` to `time_s[k + 1]` in the axes of the turning body, as such a unit sends them: not yet corrected for
    coning and sculling (Savage, Journal of Guidance, Control, and Dynamics 21, 1998). To lowest order

        R[k + 1] = R[k] exp(delta_angle)
        v[k + 1] = v[k] + R[k] (delta_velocity + delta_angle x delta_velocity / 2) + gravity dt

    Divided by the interval the increments are mean rates and forces. The site frame counts as inertial, as everywhere
    in the emulator: the celestial body does not rotate.
    """

    time_s: FloatArray
    """(n + 1,) Scenario time of the limits of the intervals, from 0."""
    delta_angle_body_rad: FloatArray
    delta_velocity_body_mps: FloatArray
    """(n, 3), as the angles."""
    gyro_bias_radps: FloatArray
    """(n, 3) True bias in each interval, constant part and instability: what a filter estimates."""
    accelerometer_bias_mps2: FloatArray
    position_site_m: FloatArray
    """(n + 1, 3) True motion at `time_s`, as the following."""
    velocity_site_mps: FloatArray
    site_from_body: FloatArray
    """(n + 1, 4) Unit quaternion w, x, y, z that turns body vectors to the site frame, w >= 0."""
    gravity_site_mps2: FloatArray
    """(n + 1, 3)"""


def simulate_imu(
    scenario: ScenarioSource,
    overrides: Mapping[str, Any] | None = None,
    *,
    rate_hz: float = 100.0,
    seed: int | None = None,
    errors: ImuErrors | None = None,
    gravity_mps2: float | None = None,
    **keys: Any,
) -> ImuSamples:
    """Simulate a strapdown inertial unit on the flight of a scenario, for a filter that the lidar aids.

    Args:
        scenario: path of a YAML file, name of a shipped scenario, mapping with the keys of a file, or a scenario.
        overrides: dotted keys and values that replace the scenario's, e.g. `{"timing.rate_hz": 100}`.
        rate_hz: increments per second.
        seed: replaces the scenario's seed; None: keep it.
        errors: deviations of the errors; None: those of an LN-200S.
        gravity_mps2: gravity at the origin of the site frame, of a central mass as in a powered descent. None: the
            powered descent's own, or 1.62 on the Moon; other flights need it.
        keys: the same as `overrides` for keys without a dot, e.g. `duration_s=5`.

    Returns:
        Increments of angle and velocity from scenario time 0 to the end of the flight, their true biases, and the true
        motion.

    Raises:
        InputError: a key or an argument cannot be used, or the scenario is a bench pattern or its truth live.
    """
    if seed is not None:
        keys["seed"] = seed
    known = require_flight(require_known_flight(load(scenario, overrides, **keys)))
    if not isinstance(errors, ImuErrors | None):
        raise InputError("simulate_imu", "errors", errors, "must be an ImuErrors")
    if gravity_mps2 is None:
        of_moon = _MOON_MPS2 if known.site.body.name == "Moon" else None
        gravity_mps2 = getattr(known.trajectory, "gravity_mps2", of_moon)
    gravity = _number("simulate_imu", "gravity_mps2", gravity_mps2, 0.0, 1000.0)
    trajectory = build_trajectory(known.trajectory, known.site.body.radius_m)
    duration_s = flown_s(known, trajectory)
    _number("simulate_imu", "rate_hz", rate_hz, 1.0, 10_000.0)
    time_s = np.arange(ceil(duration_s * rate_hz) + 1) / rate_hz
    gravity_at = partial(_gravity_at, gravity, known.site.body.radius_m)
    rng = generator(known.seed, INERTIAL)
    return _measured(trajectory, time_s, gravity_at, errors or ImuErrors(), rng)


_MOON_MPS2 = 1.62


def _number(where: str, key: str, value: object, least: float, greatest: float) -> float:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (is_number and least <= value <= greatest):  # type: ignore[operator]
        raise InputError(where, key, value, f"must be a number from {least:g} to {greatest:g}")
    return float(value)  # type: ignore[arg-type]


def _measured(
    trajectory: Trajectory,
    time_s: FloatArray,
    gravity_at: Callable[[FloatArray], FloatArray],
    errors: ImuErrors,
    rng: np.random.Generator,
) -> ImuSamples:
    step_s = float(time_s[1] - time_s[0])
    flown = trajectory.state(time_s)
    angle_rad, velocity_mps = np.zeros((2, len(time_s) - 1, 3))
    left_mps = np.diff(flown.velocity_site_mps, axis=0)
    for node, weight in zip(*np.polynomial.legendre.leggauss(_NODES), strict=True):
        state = trajectory.state(time_s[:-1] + (node + 1) / 2 * step_s)
        share_s = weight / 2 * step_s
        force_mps2 = state.acceleration_site_mps2 - gravity_at(state.position_site_m)
        angle_rad += share_s * state.body_rate_radps
        velocity_mps += share_s * rotate(np.swapaxes(state.site_from_body, -1, -2), force_mps2)
        left_mps -= share_s * state.acceleration_site_mps2
    # What the quadrature misses where the acceleration jumps: the velocity's change is known.
    velocity_mps += rotate(np.swapaxes(flown.site_from_body[:-1], -1, -2), left_mps)
    gyro, accelerometer = astuple(errors)[:5], astuple(errors)[5:]
    angle_rad, gyro_bias_radps = _with_errors(angle_rad, step_s, rng, gyro)
    velocity_mps, accelerometer_bias_mps2 = _with_errors(velocity_mps, step_s, rng, accelerometer)
    return ImuSamples(
        time_s,
        angle_rad,
        velocity_mps,
        gyro_bias_radps,
        accelerometer_bias_mps2,
        flown.position_site_m,
        flown.velocity_site_mps,
        np.array([to_quaternion(rotation) for rotation in flown.site_from_body]),
        gravity_at(flown.position_site_m),
    )


_NODES = 4
"""Of the Gauss-Legendre quadrature over an interval: exact for polynomials of degree 7."""


def _gravity_at(gravity_mps2: float, body_radius_m: float, position_site_m: FloatArray) -> FloatArray:
    """Gravity (n, 3) of a central mass below the origin of the site frame."""
    from_centre = position_site_m / body_radius_m + np.array([0.0, 0.0, 1.0])
    return np.asarray(-gravity_mps2 * from_centre / (from_centre**2).sum(axis=1, keepdims=True) ** 1.5)


def _with_errors(
    true: FloatArray, step_s: float, rng: np.random.Generator, deviations: tuple[float, ...]
) -> tuple[FloatArray, FloatArray]:
    """Increments (n, 3) with errors, and the biases (n, 3) in them."""
    bias, instability, correlation_s, random_walk, scale = deviations
    from scipy.signal import lfilter

    # A Gauss-Markov process that is stationary from the first interval on.
    kept = exp(-step_s / correlation_s)
    driving = rng.standard_normal(true.shape)
    driving[1:] *= sqrt(1 - kept**2)
    biases = bias * rng.standard_normal(3) + instability * lfilter([1.0], [1.0, -kept], driving, axis=0)
    noise = random_walk * sqrt(step_s) * rng.standard_normal(true.shape)
    return (1 + scale * rng.standard_normal(3)) * true + step_s * biases + noise, biases
