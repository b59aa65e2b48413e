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
from lidar_emu.numerics.vectors import Vector, dot, scale
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


_READ = (
    "range_valid", "range_m", "second_range_m", "speckle_bin2", "sigma_range_m", "second_sigma_range_m",
)  # fmt: skip


class FootprintDepth:
    """Adds the footprints' depth to the standard deviations of ranges.

    Args:
        model: constants of the receiver. Several looks show the depth by themselves.
    """

    def __init__(self, model: ReceiverModel) -> None:
        self._model, self._records = model, as_record(model)
        self._add: Any = _add_depths

    def added(self, returns: Returns, published: FloatArray, angle_deg: FloatArray) -> Returns:
        """Returns of whole shots, (shots, beams), with their depths.

        Args:
            published: (shots, beams, 3) unit vectors along the published axes, in any frame.
            angle_deg: (shots, beams) their angles off the boresight.
        """
        shape = returns.range_m.shape
        sigma_m, second_sigma_m, freedom = np.empty(shape), np.empty(shape), np.empty(shape)
        self._add(
            self._records,
            np.ascontiguousarray(published),
            np.ascontiguousarray(angle_deg),
            tuple([getattr(returns, name) for name in _READ]),
            (sigma_m, second_sigma_m, freedom),
        )
        return replace(
            returns,
            sigma_range_m=sigma_m,
            second_sigma_range_m=second_sigma_m,
            range_degrees_of_freedom=freedom,
        )


@kernel(outermost=True)
def _add_depths(
    models: NDArray[Any],
    published: FloatArray,
    angle_deg: FloatArray,
    return_arrays: tuple[Any, ...],
    depths: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Set the standard deviations of both ranges, and the degrees of freedom.

    Args:
        return_arrays: arrays of `Returns`, `_READ`.
    """
    model = models[0]
    valid, range_m, second_m, speckle_bin2, without_m, second_without_m = return_arrays
    sigma_m, second_sigma_m, freedom = depths
    for s in range(len(range_m)):
        normal = plane_normal(published[s], range_m[s])
        known = dot(normal, normal) > 0.0
        for b in range(range_m.shape[1]):
            sigma_m[s, b], second_sigma_m[s, b] = without_m[s, b], second_without_m[s, b]
            freedom[s, b] = SPECKLE_FREEDOM * model.looks if valid[s, b] else nan
            if model.looks > 1 or not range_m[s, b] >= 0.0:
                continue
            tangent = tan(radians(angle_deg[s, b]))
            if known:
                tangent = _tangent_of_incidence(normal, published[s, b])
            tangent = min(max(tangent, _LEAST_TANGENT), _MOST_TANGENT)
            terms = speckle_bin2[s, b]
            sigma_m[s, b], share = _with_depth(model, tangent, range_m[s, b], terms[0], sigma_m[s, b])
            freedom[s, b] = min(SPECKLE_FREEDOM / max(share * share, 1e-12), MOST_FREEDOM)
            if second_m[s, b] >= 0.0:
                second_sigma_m[s, b], _ = _with_depth(
                    model, tangent, second_m[s, b], terms[1], second_sigma_m[s, b]
                )


@kernel
def _with_depth(
    model: ReceiverModel, tangent: float, range_m: float, speckle_bin2: FloatArray, sigma_m: float
) -> tuple[float, float]:
    """A standard deviation with the depth, and the share of speckle in its square."""
    waist_m = model.wavelength_m / (pi * model.divergence_rad)
    depth_bin = hypot(waist_m, model.divergence_rad * range_m) * tangent / (sqrt(8.0) * model.range_bin_m)
    by_depth = SCALES_OF_SIGMA2 / SPECKLE_FREEDOM * (depth_bin * depth_bin + speckle_bin2[1])
    if not model.speckle:
        by_depth = 0.0
    variance = (sigma_m / model.range_bin_m) ** 2
    # Weighted least squares may weigh a noisy segment less than its quadrature was.
    stated = min(speckle_bin2[0], variance)
    variance += max(0.0, by_depth - stated)
    return sqrt(variance) * model.range_bin_m, max(by_depth, stated) / variance


@kernel
def plane_normal(published: FloatArray, range_m: FloatArray) -> Vector:
    """Normal n of the plane n·p = 1 through the points p of beams with a range, by least squares; 0: there is none.

    Args:
        published: (beams, 3) unit vectors.
        range_m: (beams,) NaN where there is no range.
    """
    farthest_m = 0.0
    for distance_m in range_m:
        if distance_m > farthest_m:
            farthest_m = distance_m
    if farthest_m == 0.0:
        return 0.0, 0.0, 0.0
    xx = xy = xz = yy = yz = zz = sx = sy = sz = 0.0
    for beam in range(len(range_m)):
        if range_m[beam] >= 0.0:
            x, y, z = scale(range_m[beam] / farthest_m, published[beam])
            xx, xy, xz, yy, yz, zz = xx + x * x, xy + x * y, xz + x * z, yy + y * y, yz + y * z, zz + z * z
            sx, sy, sz = sx + x, sy + y, sz + z
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    determinant = xx * a + xy * b + xz * c
    trace = (xx + yy + zz) / 3.0
    if not determinant > _LEAST_DETERMINANT * trace**3:
        return 0.0, 0.0, 0.0
    d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    return (
        (a * sx + b * sy + c * sz) / determinant,
        (b * sx + d * sy + e * sz) / determinant,
        (c * sx + e * sy + f * sz) / determinant,
    )


@kernel
def _tangent_of_incidence(normal: Vector, axis: FloatArray) -> float:
    along = dot(normal, axis)
    if along == 0.0:
        return inf
    return sqrt(max(0.0, dot(normal, normal) / (along * along) - 1.0))
