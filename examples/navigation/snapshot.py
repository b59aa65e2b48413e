"""The solution of a single shot: velocity, and the plane of the ground, by weighted least squares with a parity check.

It uses only geometry and the standard deviations in the packet. Three beams are required; a fourth shows whether they
agree.
"""

from typing import NamedTuple

import numpy as np
from beams import Array, Shot


class Fit(NamedTuple):
    """Least-squares solution for three unknowns from n values."""

    value: Array
    """(3,) Solution."""
    covariance: Array
    """(3, 3) Covariance, if the stated standard deviations are correct."""
    parity: Array
    """(n - 3,) Parity, the contradiction of the values: independent, of variance 1, whatever the unknowns are."""


class Plane(NamedTuple):
    """The plane of the ground in the body frame."""

    distance_m: float
    """Distance along the normal."""
    normal_body: Array
    """Unit normal, away from the ground."""
    fit: Fit
    """Fit of the vector toward the ground with length 1 / distance; 1 / range is its component along a beam."""


def fit(design: Array, values: Array, sigmas: Array) -> Fit | None:
    """Solve `design @ unknowns = values`, (n, 3) and (n,), by least squares; None if the unknowns are not observable.

    The parity is the projection onto the complement of the weighted design's columns (Potter and Suman, 1977).
    """
    if len(values) < 3:
        return None
    weighted, scaled = design / sigmas[:, None], values / sigmas
    left, singular, right = np.linalg.svd(weighted)
    if not singular[2] > 1e-9 * singular[0]:
        return None
    inverse = right.T / singular
    return Fit(inverse @ (left[:, :3].T @ scaled), inverse @ inverse.T, left[:, 3:].T @ scaled)


def velocity(shot: Shot) -> Fit | None:
    """Velocity relative to the ground in the body's axes, m/s."""
    valid = np.isfinite(shot.closing_speed_mps)
    return fit(shot.directions_body[valid], shot.closing_speed_mps[valid], shot.sigma_speed_mps[valid])


def plane(shot: Shot) -> Plane | None:
    """Plane nearest to the footprints; None also if it would not be below the beams."""
    valid = shot.range_m > 0
    beams, range_m, sigma_m = shot.directions_body[valid], shot.range_m[valid], shot.sigma_range_m[valid]
    found = fit(beams, 1 / range_m, sigma_m / range_m**2)
    for _ in range(3):  # Gauss and Newton: ranges are not linear in the plane
        if found is None or not np.all(beams @ found.value > 0):
            return None
        found = ranges_about(found.value, beams, range_m, sigma_m)
    if found is None:
        return None
    length = float(np.linalg.norm(found.value))
    return Plane(1 / length, -found.value / length, found)


def ranges_about(toward_body: Array, beams: Array, range_m: Array, sigma_m: Array) -> Fit | None:
    """One Gauss-Newton step from a plane, with `toward_body` as in `Plane.fit`.

    The parity is in units of range sigmas, contains no squared noise and is independent of the plane: to first order it
    equals the parity of every plane nearby.
    """
    expected_m = 1 / (beams @ toward_body)
    step = fit(-(expected_m[:, None] ** 2) * beams, range_m - expected_m, sigma_m)
    return None if step is None else step._replace(value=toward_body + step.value)


def dilution(beams: Array) -> Array:
    """Standard deviation (3,) of each velocity component if every beam has sigma 1."""
    valid = fit(beams, np.zeros(len(beams)), np.ones(len(beams)))
    return np.full(3, np.nan) if valid is None else np.sqrt(np.diag(valid.covariance))
