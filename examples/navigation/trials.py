"""Trials of a navigator on a scenario's flight: initial errors, comparison with the truth, whole flights without link
or clock."""

from typing import NamedTuple

import numpy as np
from beams import Array, from_run
from error_state import ATTITUDE, HEIGHT, MARE, POSITION, VELOCITY, ErrorState, Ground, rotation
from inertial import TACTICAL, Grade
from navigation import Navigator
from simulated_inertial import SimulatedInertial, rotation_vectors
from trust import CAREFUL, Rules
from truth import TrueState, Truth

from lidar_emu.measurement import Measurement

START_SIGMAS = np.array([10.0, 10.0, 50.0, 1.0, 1.0, 1.0, 5e-4, 5e-4, 5e-4])
"""Standard deviations of position, velocity and attitude before the first shot."""
KNOWN = 9
"""Number of errors with a known truth: position, velocity and attitude."""


def start(
    truth: Truth,
    time_ns: int,
    seed: int,
    rules: Rules = CAREFUL,
    ground: Ground = MARE,
    grade: Grade = TACTICAL,
) -> Navigator:
    """Initialise a navigator at an instant of a flight, with initial errors of the stated size and its own inertial
    unit."""
    rng = np.random.default_rng(seed)
    inertial = SimulatedInertial(truth, rng, grade)
    true, off = truth.at(time_ns), START_SIGMAS * rng.standard_normal(9)
    state = ErrorState(
        true.position_site_m + off[POSITION],
        true.velocity_site_mps + off[VELOCITY],
        rotation(off[ATTITUDE]) @ true.site_from_body,
        START_SIGMAS,
        grade,
        ground,
    )
    return Navigator(state, inertial, time_ns, truth.sheet, rules)


def errors(state: ErrorState, true: TrueState) -> Array:
    """Errors (9,) of position, velocity and attitude, as true minus estimate, in the order of the covariance."""
    turned = (true.site_from_body @ state.site_from_body.T)[None]
    return np.concatenate(
        [
            true.position_site_m - state.position_site_m,
            true.velocity_site_mps - state.velocity_site_mps,
            rotation_vectors(turned)[0],
        ]
    )


class Log(NamedTuple):
    """Results shot by shot."""

    time_s: Array
    """(shots,)"""
    height_m: Array
    """(shots,) True height above the ground straight below."""
    errors: Array
    """(shots, 9) Errors of position, velocity and attitude."""
    covariance: Array
    """(shots, 9, 9) Covariance that the filter states for them."""
    nis: Array
    """(shots, 2) Normalised innovations squared of ranges and speeds."""
    accepted: Array
    """(shots, 2) Beams accepted."""
    reinitialised: Array
    """(shots, 2) Whether height or velocity was reinitialised."""


def fly(truth: Truth, run: Measurement, navigator: Navigator) -> Log:
    """Pass the shots of a run to a navigator."""
    rows = []
    for k in range(len(run)):
        result = navigator.take(from_run(run, k, truth.sheet))
        if result is None:
            continue
        true = truth.at(navigator.time_ns)
        covariance = navigator.state.covariance[:KNOWN, :KNOWN].copy()
        rows.append(
            (
                navigator.time_ns * 1e-9,
                true.position_site_m[HEIGHT],
                errors(navigator.state, true),
                covariance,
                [each.nis for each in result],
                [each.accepted for each in result],
                [each.reinitialised for each in result],
            )
        )
    return Log(*(np.array(column, dtype=np.float64) for column in zip(*rows, strict=True)))


def normalised(errors: Array, covariance: Array) -> Array:
    """Errors (n, k) squared, normalised by their covariances (n, k, k): chi-square of k degrees if correct."""
    solved = np.linalg.solve(covariance, errors[:, :, None])
    squares: Array = np.einsum("ni,ni->n", errors, solved[:, :, 0])
    return squares
