"""What one shot says by itself: velocity, and the plane of the ground, by weighted least squares with a parity check.

Nothing but geometry and the standard deviations in the packet. Three beams are needed; a fourth tells whether they
agree.
"""

from typing import NamedTuple

import numpy as np
from beams import Array, Shot


class Fit(NamedTuple):
    """Three unknowns from n values."""

    value: Array
    """(3,)"""
    covariance: Array
    """(3, 3), as far as the stated standard deviations are true."""
    parity: Array
    """(n - 3,) What the values say against each other: independent, of variance 1, whatever the unknowns are."""


class Plane(NamedTuple):
    """The ground, from the body."""

    distance_m: float
    """Along the normal."""
    normal_body: Array
    """Up: away from the ground."""
    fit: Fit
    """Of the vector that points to the ground, as long as 1 / distance: 1 / range is its component along a beam."""


def fit(design: Array, values: Array, sigmas: Array) -> Fit | None:
    """Least squares of `design @ unknowns = values`, (n, 3) and (n,); None if they do not tell three unknowns.

    The parity is what the complement of the weighted design's columns sees (Potter and Suman, 1977).
    """
    if len(values) < 3:
        return None
    weighted, scaled = design / sigmas[:, None], values / sigmas
    left, stretch, right = np.linalg.svd(weighted)
    if not stretch[2] > 1e-9 * stretch[0]:
        return None
    inverse = right.T / stretch
    return Fit(inverse @ (left[:, :3].T @ scaled), inverse @ inverse.T, left[:, 3:].T @ scaled)


def velocity(shot: Shot) -> Fit | None:
    """Velocity against the ground along the body's axes, m/s."""
    told = np.isfinite(shot.closing_speed_mps)
    return fit(shot.directions_body[told], shot.closing_speed_mps[told], shot.sigma_speed_mps[told])


def plane(shot: Shot) -> Plane | None:
    """The plane nearest to the footprints; None too if it would not be below the beams."""
    told = shot.range_m > 0
    beams, range_m, sigma_m = shot.directions_body[told], shot.range_m[told], shot.sigma_range_m[told]
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
    """One step from a plane, `toward_body` being the vector that `Plane.fit` tells.

    Its parity counts in ranges, is free of noise that is squared, and knows of no plane: to first order it is that of
    every plane nearby.
    """
    expected_m = 1 / (beams @ toward_body)
    step = fit(-(expected_m[:, None] ** 2) * beams, range_m - expected_m, sigma_m)
    return None if step is None else step._replace(value=toward_body + step.value)


def dilution(beams: Array) -> Array:
    """(3,) Standard deviation of each component of velocity where each beam's is 1."""
    told = fit(beams, np.zeros(len(beams)), np.ones(len(beams)))
    return np.full(3, np.nan) if told is None else np.sqrt(np.diag(told.covariance))
