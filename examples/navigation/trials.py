"""A whole flight through a navigator, without wire or clock: how algorithms are tried."""

from typing import NamedTuple

import numpy as np
from beams import Array, from_run
from error_state import POSITION
from navigation import Navigator, errors
from truth import Truth

from lidar_emu.measurement import Measurement

KNOWN = 9
"""Errors that have a truth beside them: those of position, velocity and attitude."""


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
                true.position_site_m[POSITION][-1],
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
    return np.einsum("ni,ni->n", errors, solved[:, :, 0])
