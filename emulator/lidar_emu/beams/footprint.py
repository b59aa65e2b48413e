"""The footprint of a beam, sampled by beamlets.

A Gaussian beam has the waist radius w0 at the sensor and the Rayleigh range z = pi w0² / wavelength. At range R its
1/e² radius is w = w0 sqrt(1 + (R/z)²) and its wavefronts have the radius Rc = R (1 + (z/R)²). Transmitted and received
modes are equal, so that the ground at a distance r from the axis contributes with exp(-4 r²/w²).
"""

from __future__ import annotations

from functools import cache
from math import hypot, sqrt
from typing import Any, NamedTuple, Self

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import dot


def rayleigh_range_m(waist_radius_m: float, wavelength_m: float) -> float:
    """Rayleigh range z, at which the beam's area has doubled."""
    return float(np.pi * waist_radius_m**2 / wavelength_m)


def beam_radius_m(range_m: FloatArray, waist_radius_m: float, wavelength_m: float) -> FloatArray:
    """1/e² intensity radii w of a Gaussian beam at ranges (...)."""
    ratio = range_m / rayleigh_range_m(waist_radius_m, wavelength_m)
    radius_m: FloatArray = waist_radius_m * np.sqrt(1 + ratio * ratio)
    return radius_m


def wavefront_radius_m(range_m: FloatArray, waist_radius_m: float, wavelength_m: float) -> FloatArray:
    """Radii of curvature Rc of a Gaussian beam's wavefront at ranges (...); infinite at the waist."""
    rayleigh_m = rayleigh_range_m(waist_radius_m, wavelength_m)
    with np.errstate(divide="ignore", over="ignore"):
        radius_m: FloatArray = range_m + rayleigh_m * (rayleigh_m / range_m)
    return radius_m


_OUTERMOST_W = {7: np.sqrt(0.5)}
_OUTERMOST_OTHERWISE_W = 1.1445706
"""Distance of the corners of the outermost ring. With 7 and 19 beamlets it makes the fourth moment exact. More beamlets
fill the same disc, which holds 99.5 % of the power, more densely: a spectrum spread over many bins needs a small
spacing rather than a large disc."""

_LEAST_SIDE = 1e-140
"""Smallest component whose square keeps all its digits."""


class Footprint(NamedTuple):
    """Straight rays from the aperture through the footprint, in the site frame; arrays are (beams, beamlets, 3)."""

    weight: FloatArray
    """(beamlets,) Fraction of the beam's power; they sum to 1."""
    start_site_m: FloatArray
    ray_site: FloatArray
    """Unit vectors along the rays."""
    doppler_site: FloatArray
    """Unit vectors: gradient of the beam's phase at the ground, along which a velocity causes Doppler shift. In the far
    field this is the direction of `ray_site`; near the waist the wavefront is flatter."""
    across_site: FloatArray
    """(2, beams, 3) Two unit vectors perpendicular to the axis and to each other, the axes of the offsets."""
    doppler_start_m: FloatArray
    """(2, beams, beamlets) Offsets along `across_site` of the point in the aperture plane at which a straight line
    along `doppler_site` starts. When the sensor rotates, the Doppler shift depends on the velocity of this point: for a
    footprint point at offset x it is x (1 - R/Rc), x in the near field and 0 in the far field."""

    @classmethod
    def unfilled(cls, beams: int, weight: FloatArray) -> Self:
        """Allocate arrays for a kernel to fill, with a beamlet of each of these weights per beam."""
        shape = (beams, len(weight), 3)
        return cls(
            weight=weight,
            start_site_m=np.empty(shape),
            ray_site=np.empty(shape),
            doppler_site=np.empty(shape),
            across_site=np.empty((2, beams, 3)),
            doppler_start_m=np.empty((2, *shape[:2])),
        )


def sample_footprint(
    sensor_site_m: FloatArray,
    axis_site: FloatArray,
    range_m: FloatArray,
    beamlets: int | FloatArray,
    waist_radius_m: float,
    wavelength_m: float,
    footprint: Footprint | None = None,
) -> Footprint:
    """Sample the footprints of beams by beamlets.

    Args:
        sensor_site_m: (beams, 3) centre of the aperture, in the site frame.
        axis_site: (beams, 3) unit vectors of the beams' axes; NaN for a beam that does not fire.
        range_m: (beams,) along the axis to the ground; NaN where it meets none: the beam's far field is taken.
        beamlets: number, as in `beamlet_pattern`, or offsets (beams or 1, beamlets, 2) of rays of equal weights.
        waist_radius_m: 1/e² radius at the sensor.
        wavelength_m: of the light.
        footprint: to be filled and returned; None: a new one.

    A ray joins the points of the aperture and of the footprint with the same share of the beam's power
    inside. Its slope (w - w0)/R and the slope of the phase w/Rc, per radius, are written in z/R, as is w (1 - R/Rc) =
    w0²/w: none cancels nor divides by zero, from a range of 0 to infinity.
    """
    if isinstance(beamlets, int):
        pattern_w, weight = beamlet_pattern(beamlets)
        offset_w = pattern_w[None]
    else:
        offset_w, weight = beamlets, np.full(beamlets.shape[1], 1.0 / beamlets.shape[1])
    footprint = footprint or Footprint.unfilled(len(range_m), weight)
    rayleigh_m = rayleigh_range_m(waist_radius_m, wavelength_m)
    _sample(offset_w, waist_radius_m, rayleigh_m, sensor_site_m, axis_site, range_m, tuple(footprint))
    return footprint


@kernel(outermost=True)
def _sample(
    offset_w: FloatArray,
    waist_radius_m: float,
    rayleigh_m: float,
    sensor_m: FloatArray,
    axes: FloatArray,
    range_m: FloatArray,
    footprint_arrays: tuple[Any, ...],
) -> None:
    footprint = Footprint(*footprint_arrays)
    start_m, ray, doppler = footprint.start_site_m, footprint.ray_site, footprint.doppler_site
    across, doppler_start_m = footprint.across_site, footprint.doppler_start_m
    divergence = waist_radius_m / rayleigh_m
    for b in range(len(axes)):
        axis, first, second = axes[b], across[0, b], across[1, b]
        _set_perpendicular(axis, first, second)
        farness = range_m[b] / rayleigh_m
        if farness != farness:
            farness = np.inf
        nearness = 1 / farness
        root = sqrt(1 + nearness * nearness)
        ray_slope, doppler_slope = divergence / (root + nearness), divergence / root
        back_m = waist_radius_m / hypot(1.0, farness)
        offsets = offset_w[b if len(offset_w) > 1 else 0]
        for i in range(len(offsets)):
            along_first, along_second = offsets[i, 0], offsets[i, 1]
            for side in range(3):
                sideways = along_first * first[side] + along_second * second[side]
                start_m[b, i, side] = sensor_m[b, side] + waist_radius_m * sideways
                ray[b, i, side] = axis[side] + ray_slope * sideways
                doppler[b, i, side] = axis[side] + doppler_slope * sideways
            _normalise(ray[b, i])
            _normalise(doppler[b, i])
            doppler_start_m[0, b, i] = back_m * along_first
            doppler_start_m[1, b, i] = back_m * along_second


@kernel
def _normalise(vector: FloatArray) -> None:
    shrink = 1.0 / sqrt(dot(vector, vector))
    for side in range(3):
        vector[side] *= shrink


@cache
def beamlet_pattern(count: int) -> tuple[FloatArray, FloatArray]:
    """Offsets (count, 2) in units of the 1/e² radius w, and weights (count,) that sum to 1.

    The pattern is a centre and complete hexagonal rings: 1, 7, 19, 37, 61, 91 or 127 beamlets. Weights follow exp(-b
    r²/w²); b is slightly below the beam's 4, so that the mean of r² is the beam's w²/4 exactly although the pattern is
    truncated. By sixfold symmetry all other moments up to degree 5 are exact except the mean of r⁴, which is exact with
    7 and 19 beamlets and 3 % to 6 % low with 37 to 127. A single beamlet has no width.

    Raises:
        ValueError: the count is not allowed.
    """
    offset_w, weight = _hexagons(count), np.ones(1)
    if count > 1:
        offset_w *= _OUTERMOST_W.get(count, _OUTERMOST_OTHERWISE_W) / np.sqrt(np.max(_squared(offset_w)))
        weight = _weights(_squared(offset_w), mean_square=0.25)
    # The same pattern serves every shot.
    offset_w.flags.writeable = weight.flags.writeable = False
    return offset_w, weight


@kernel
def _set_perpendicular(axis: FloatArray, first: FloatArray, second: FloatArray) -> None:
    """Set two unit vectors (3,) perpendicular to a unit vector (3,) and to each other: x and y, rotated by the shortest
    rotation from straight down to the axis.

    The vectors vary smoothly except at straight up, where that rotation is undetermined (every tangent field on a
    sphere has such a point) and which a landing lidar does not use; there the rotation is taken in the x-z plane.
    """
    x, y, z = axis[0], axis[1], axis[2]
    if z > 0 and x * x + y * y < _LEAST_SIDE**2:
        x, y = _LEAST_SIDE, 0.0
    # 1 - z cancels near straight up.
    from_up = (x * x + y * y) / (1 + z) if z > 0 else 1 - z
    mixed = -x * y / from_up
    first[0], first[1], first[2] = 1 - x * x / from_up, mixed, x
    second[0], second[1], second[2] = mixed, 1 - y * y / from_up, y


def _hexagons(count: int) -> FloatArray:
    """Centre and complete rings of a triangular lattice of unit spacing, from the centre outward: (count, 2)."""
    corner = np.array([np.exp(1j * np.pi * k / 3) for k in range(7)])
    points = [0j]
    ring = 0
    while len(points) < count:
        ring += 1
        points += [
            ring * corner[side] + step * (corner[side + 1] - corner[side])
            for side in range(6)
            for step in range(ring)
        ]
    if len(points) != count:
        raise ValueError(f"{count} beamlets; must be 1, 7, 19, 37, ...: whole hexagons")
    return np.array([[point.real, point.imag] for point in points])


def _squared(offset: FloatArray) -> FloatArray:
    return np.asarray(offset[:, 0] ** 2 + offset[:, 1] ** 2)


def _weights(squared: FloatArray, mean_square: float) -> FloatArray:
    """Normalised weights exp(-b r²), with b from a bisection such that the weighted mean of r² is `mean_square`."""
    low, high = 2.0, 5.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        weight = np.exp(-middle * squared)
        weight /= weight.sum()
        if (weight * squared).sum() > mean_square:
            low = middle
        else:
            high = middle
    return weight
