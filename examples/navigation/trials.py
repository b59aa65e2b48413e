"""A navigator on a scenario's flight: started with errors, compared with the truth, flown without wire or clock."""

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
"""Of position, velocity and attitude before the first shot."""
KNOWN = 9
"""Errors that have a truth beside them: those of position, velocity and attitude."""


def start(
    truth: Truth,
    time_ns: int,
    seed: int,
    rules: Rules = CAREFUL,
    ground: Ground = MARE,
    grade: Grade = TACTICAL,
) -> Navigator:
    """A navigator at an instant of a flight, off by errors as large as it thinks, with an inertial unit of its own."""
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
    """(9,) What is to be added to position, velocity and attitude: the first rows of the covariance are about these."""
    turned = (true.site_from_body @ state.site_from_body.T)[None]
    return np.concatenate(
        [
            true.position_site_m - state.position_site_m,
            true.velocity_site_mps - state.velocity_site_mps,
            rotation_vectors(turned)[0],
        ]
    )


class Log(NamedTuple):
    """Shot by shot."""

    time_s: Array
    """(shots,)"""
    height_m: Array
    """(shots,) True, above the ground straight below."""
    errors: Array
    """(shots, 9) Of position, velocity and attitude."""
    covariance: Array
    """(shots, 9, 9) That the filter states for them."""
    surprise: Array
    """(shots, 2) Of ranges and speeds: innovations squared, over their covariance."""
    taken: Array
    """(shots, 2) Beams that went into it."""
    began_again: Array
    """(shots, 2)"""


def fly(truth: Truth, run: Measurement, navigator: Navigator) -> Log:
    """Hand shot after shot to a navigator."""
    rows = []
    for k in range(len(run)):
        became = navigator.take(from_run(run, k, truth.sheet))
        if became is None:
            continue
        true = truth.at(navigator.time_ns)
        covariance = navigator.state.covariance[:KNOWN, :KNOWN].copy()
        rows.append(
            (
                navigator.time_ns * 1e-9,
                true.position_site_m[HEIGHT],
                errors(navigator.state, true),
                covariance,
                [each.surprise for each in became],
                [each.taken for each in became],
                [each.begun_again for each in became],
            )
        )
    return Log(*(np.array(column, dtype=np.float64) for column in zip(*rows, strict=True)))


def normalised(errors: Array, covariance: Array) -> Array:
    """(n,) Errors (n, k) squared over their covariance (n, k, k): chi-square of k degrees if that is true."""
    solved = np.linalg.solve(covariance, errors[:, :, None])
    squares: Array = np.einsum("ni,ni->n", errors, solved[:, :, 0])
    return squares
