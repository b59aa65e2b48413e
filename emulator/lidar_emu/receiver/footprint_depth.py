"""Standard deviation of ranges by the depth of their footprints, from the incidence on a plane through a shot's points.

Speckle that hardly changes within a measurement shows each of a slope's scatterers with a weight of its own. With the
depth d = w tan θ/√8, the rms of a footprint of the 1/e² radius w along the beam, range is off by d Re(n/a), n and a
independent circular Gaussian numbers: |a|² is the record's power. The quadrature q of the range (`stated_variance`) is
d Im(n/a). With d and q known, the error follows Student's law of three degrees of freedom and the scale
√((d² + q²)/3), whose 68.27 % quantile is 1.197 scales: that is the standard deviation which is stated.

The incidence θ is that on the plane through the points of the shot's beams. Where fewer than three beams have a range,
or they are nearly parallel, the ground is taken to be level and the boresight vertical.
"""

from __future__ import annotations

from dataclasses import replace
from math import hypot, inf, nan, pi, radians, sqrt, tan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray, as_record
from lidar_emu.numerics.kernels import kernel
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import Returns

SCALES_OF_SIGMA2 = 1.433
"""Square of the 68.27 % quantile of Student's law of three degrees of freedom."""

SPECKLE_FREEDOM = 3.0
"""Degrees of freedom of errors by speckle: as many quadratures determine their variance, or power and quadrature."""

MOST_FREEDOM = 1000.0
"""Degrees of freedom at which an error counts as Gaussian."""

_LEAST_TANGENT, _MOST_TANGENT = 0.03, tan(radians(89.0))
"""Limits of the tangent of incidence: no ground is flatter within a footprint, none is seen that is steeper."""

_LEAST_DETERMINANT = 1e-4
"""Determinant of the normal equations, for a trace of 3, from which points determine a plane: four beams 3.6 degrees
off their axis."""


def with_footprint_depth(
    model: ReceiverModel, returns: Returns, published: FloatArray, angle_deg: FloatArray
) -> Returns:
    """Add the footprints' depth to the standard deviations of ranges.

    Args:
        model: constants of the receiver. Several looks show the depth by themselves.
        returns: of whole shots, (shots, beams).
        published: (shots, beams, 3) unit vectors along the published axes, in any frame.
        angle_deg: (shots, beams) their angles off the boresight.
    """
    freedom = np.where(returns.range_valid, SPECKLE_FREEDOM * model.looks, nan)
    if model.looks > 1:
        return replace(returns, range_degrees_of_freedom=freedom)
    ranges_m = np.stack([returns.range_m, returns.second_range_m], axis=-1)
    sigma_m = np.stack([returns.sigma_range_m, returns.second_sigma_range_m], axis=-1)
    add: Any = _add_depths
    add(
        as_record(model),
        np.ascontiguousarray(published),
        np.ascontiguousarray(angle_deg),
        ranges_m,
        np.ascontiguousarray(returns.speckle_bin2),
        sigma_m,
        freedom,
    )
    return replace(
        returns,
        sigma_range_m=sigma_m[..., 0],
        second_sigma_range_m=sigma_m[..., 1],
        range_degrees_of_freedom=freedom,
    )


@kernel(outermost=True)
def _add_depths(
    models: NDArray[Any],
    published: FloatArray,
    angle_deg: FloatArray,
    ranges_m: FloatArray,
    speckle_bin2: FloatArray,
    sigma_m: FloatArray,
    freedom: FloatArray,
) -> None:
    model = models[0]
    for s in range(len(ranges_m)):
        normal = plane_normal(published[s], ranges_m[s, :, 0])
        for b in range(ranges_m.shape[1]):
            if not ranges_m[s, b, 0] >= 0.0:
                continue
            tangent = tan(radians(angle_deg[s, b]))
            if normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2] > 0.0:
                tangent = _tangent_of_incidence(normal, published[s, b])
            tangent = min(max(tangent, _LEAST_TANGENT), _MOST_TANGENT)
            for surface in range(2):
                if ranges_m[s, b, surface] >= 0.0:
                    share = _add_depth(
                        model,
                        tangent,
                        ranges_m[s, b, surface],
                        speckle_bin2[s, b, surface],
                        sigma_m[s, b],
                        surface,
                    )
                    if surface == 0:
                        freedom[s, b] = min(SPECKLE_FREEDOM / max(share * share, 1e-12), MOST_FREEDOM)


@kernel
def _add_depth(
    model: ReceiverModel,
    tangent: float,
    range_m: float,
    speckle_bin2: FloatArray,
    sigma_m: FloatArray,
    at: int,
) -> float:
    """Add the depth to one of the standard deviations; return the share of speckle in its variance."""
    waist_m = model.wavelength_m / (pi * model.divergence_rad)
    depth_bin = hypot(waist_m, model.divergence_rad * range_m) * tangent / (sqrt(8.0) * model.range_bin_m)
    by_depth = SCALES_OF_SIGMA2 / SPECKLE_FREEDOM * (depth_bin * depth_bin + speckle_bin2[1])
    if not model.speckle:
        by_depth = 0.0
    variance = (sigma_m[at] / model.range_bin_m) ** 2
    # Weighted least squares may weigh a noisy segment less than its quadrature was.
    stated = min(speckle_bin2[0], variance)
    variance += max(0.0, by_depth - stated)
    sigma_m[at] = sqrt(variance) * model.range_bin_m
    return float(max(by_depth, stated) / variance)


@kernel
def plane_normal(published: FloatArray, range_m: FloatArray) -> tuple[float, float, float]:
    """Normal n of the plane n·p = 1 through the points p of beams with a range, by least squares; 0: there is none.

    Args:
        published: (beams, 3) unit vectors.
        range_m: (beams,) NaN where there is no range.
    """
    farthest_m = 0.0
    for b in range(len(range_m)):
        if range_m[b] > farthest_m:
            farthest_m = range_m[b]
    if farthest_m == 0.0:
        return 0.0, 0.0, 0.0
    xx = xy = xz = yy = yz = zz = sx = sy = sz = 0.0
    for b in range(len(range_m)):
        if range_m[b] >= 0.0:
            scale = range_m[b] / farthest_m
            x, y, z = published[b, 0] * scale, published[b, 1] * scale, published[b, 2] * scale
            xx, xy, xz, yy, yz, zz = xx + x * x, xy + x * y, xz + x * z, yy + y * y, yz + y * z, zz + z * z
            sx, sy, sz = sx + x, sy + y, sz + z
    a, b_, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    determinant = xx * a + xy * b_ + xz * c
    trace = (xx + yy + zz) / 3.0
    if not determinant > _LEAST_DETERMINANT * trace**3:
        return 0.0, 0.0, 0.0
    d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    return (
        (a * sx + b_ * sy + c * sz) / determinant,
        (b_ * sx + d * sy + e * sz) / determinant,
        (c * sx + e * sy + f * sz) / determinant,
    )


@kernel
def _tangent_of_incidence(normal: tuple[float, float, float], axis: FloatArray) -> float:
    along = normal[0] * axis[0] + normal[1] * axis[1] + normal[2] * axis[2]
    square = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]
    if along == 0.0:
        return inf
    return sqrt(max(0.0, square / (along * along) - 1.0))
