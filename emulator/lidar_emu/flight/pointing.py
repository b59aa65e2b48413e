"""Pointing of the beams, and its kernels: from the motion of the vehicle to the starts and directions of beams."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.rotations import rotate
from lidar_emu.numerics.vectors import add, cross, dot, nan_to_zero, store

SENSOR, VELOCITY, ACCELERATION, TURNING, TRUE, PUBLISHED = range(6)
"""Places of the vectors of a beam, in the order of `Pointing`."""


class Pointing(NamedTuple):
    """Where the beams start and point; arrays are (shots, beams) and (shots, beams, 3), NaN for absent beams."""

    shot: NDArray[np.int64]
    """(shots,)"""
    pattern: NDArray[np.int64]
    """(shots,) Which pattern of beams the shot uses."""
    time_ns: NDArray[np.int64]
    in_gap: BoolArray
    """Where the vehicle is follows there from a bridge over a gap of its table."""
    fired: BoolArray
    angle_deg: FloatArray
    beams: FloatArray
    """(6, shots, beams, 3) The vectors named below, together for kernels: their places are in `pointing`."""
    vehicle: FloatArray
    """(2, shots, 3) Position and velocity."""

    @classmethod
    def unfilled(cls, shot: NDArray[np.int64], beams: int) -> Self:
        """Empty arrays for these shots of `beams` beams."""
        shape = len(shot), beams
        return cls(
            shot=shot,
            pattern=np.empty(len(shot), dtype=np.int64),
            time_ns=np.empty(shape, dtype=np.int64),
            in_gap=np.zeros(shape, dtype=np.bool_),
            fired=np.empty(shape, dtype=np.bool_),
            angle_deg=np.empty(shape),
            beams=np.empty((6, *shape, 3)),
            vehicle=np.empty((2, len(shot), 3)),
        )

    @property
    def sensor_site_m(self) -> FloatArray:
        """Centre of the aperture."""
        return self._of_beams(SENSOR)

    @property
    def sensor_velocity_site_mps(self) -> FloatArray:
        """Of the sensor, which the lever arm moves."""
        return self._of_beams(VELOCITY)

    @property
    def sensor_acceleration_site_mps2(self) -> FloatArray:
        """The body's angular rate is taken as steady: its change, times the lever arm, is left out."""
        return self._of_beams(ACCELERATION)

    @property
    def turning_site_radps(self) -> FloatArray:
        """Angular rate of the body, and of the beams with it."""
        return self._of_beams(TURNING)

    @property
    def true_site(self) -> FloatArray:
        """Where the light goes."""
        return self._of_beams(TRUE)

    @property
    def position_site_m(self) -> FloatArray:
        """(shots, 3) Of the vehicle at the first beam's validity."""
        return np.asarray(self.vehicle[0])

    @property
    def velocity_site_mps(self) -> FloatArray:
        """(shots, 3)"""
        return np.asarray(self.vehicle[1])

    def _of_beams(self, place: int) -> FloatArray:
        vectors: FloatArray = self.beams[place]
        return vectors


@kernel(outermost=True)
def set_times(
    shot: NDArray[np.int64],
    period_ns: int,
    validity_ns: IntArray,
    time_ns: IntArray,
    instant_s: FloatArray,
) -> None:
    """Set times of validity (shots, beams), and instants (shots, 1 + beams): the shot's start and then these."""
    for s in range(len(shot)):
        start_ns = shot[s] * period_ns
        instant_s[s, 0] = start_ns * 1e-9
        for b in range(len(validity_ns)):
            time_ns[s, b] = start_ns + validity_ns[b]
            instant_s[s, 1 + b] = time_ns[s, b] * 1e-9


@kernel(outermost=True)
def place_starts(
    instant_s: FloatArray,
    position_m: FloatArray,
    site_from_body: FloatArray,
    lever_arm_m: FloatArray,
    starts: FloatArray,
) -> None:
    """Take from the first of each shot's instants its time, and where the sensor is then: (4, shots)."""
    for s in range(starts.shape[1]):
        starts[0, s] = instant_s[s, 0]
        k = s * instant_s.shape[1]
        for axis in range(3):
            starts[1 + axis, s] = position_m[k, axis] + dot(site_from_body[k, axis], lever_arm_m)


@kernel(outermost=True)
def point_beams(
    position_m: FloatArray,
    velocity_mps: FloatArray,
    acceleration_mps2: FloatArray,
    site_from_body: FloatArray,
    body_rate_radps: FloatArray,
    lever_arm_m: FloatArray,
    row: NDArray[np.int64],
    row_angle_deg: FloatArray,
    true_body: FloatArray,
    published_body: FloatArray,
    fired: BoolArray,
    angle_deg: FloatArray,
    vectors: FloatArray,
    vehicle: FloatArray,
) -> None:
    """Fill what `Pointing` consists of; the vehicle is given at 1 + beams instants of each shot, the first unused.

    The lever arm turns with the body: r, ω x r and ω x (ω x r) are added.

    Args:
        row: (shots,) of directions and angles (rows, beams) that each shot takes.
        vectors: (6, shots, beams, 3) in the order of `Pointing`.
        vehicle: (2, shots, 3) the vehicle's position and velocity at the first beam's validity.
    """
    shots, beams = fired.shape
    for s in range(shots):
        for b in range(beams):
            k = s * (1 + beams) + 1 + b
            rotation = site_from_body[k]
            turning = rotate(rotation, body_rate_radps[k])
            lever_arm = rotate(rotation, lever_arm_m)
            swing = cross(turning, lever_arm)
            store(vectors[TURNING, s, b], 0, turning)
            store(vectors[SENSOR, s, b], 0, add(lever_arm, position_m[k]))
            store(vectors[VELOCITY, s, b], 0, add(swing, velocity_mps[k]))
            store(vectors[ACCELERATION, s, b], 0, add(cross(turning, swing), acceleration_mps2[k]))
            store(vectors[TRUE, s, b], 0, rotate(rotation, true_body[row[s], b]))
            store(vectors[PUBLISHED, s, b], 0, rotate(rotation, published_body[row[s], b]))
            angle_deg[s, b] = row_angle_deg[row[s], b]
            fired[s, b] = angle_deg[s, b] == angle_deg[s, b]
        for axis in range(3):
            vehicle[0, s, axis] = position_m[s * (1 + beams) + 1, axis]
            vehicle[1, s, axis] = velocity_mps[s * (1 + beams) + 1, axis]


@kernel(outermost=True)
def approach(
    beams: FloatArray,
    normals: FloatArray,
    surface_mps: FloatArray,
    true_closing_mps: FloatArray,
    true_incidence_deg: FloatArray,
) -> None:
    """The sensor's speed along the true axis, less that of what is hit, if it moves; and the angle between the axis
    and the normal (shots, beams, 3) of what it hits, NaN where that is nothing."""
    for s in range(true_closing_mps.shape[0]):
        for b in range(true_closing_mps.shape[1]):
            axis = beams[TRUE, s, b]
            true_closing_mps[s, b] = dot(beams[VELOCITY, s, b], axis)
            if surface_mps.size > 0:
                true_closing_mps[s, b] -= nan_to_zero(dot(surface_mps[s, b], axis))
            # Bounds first: np.minimum passes NaN on, min() may not.
            cosine = np.minimum(np.maximum(-dot(normals[s, b], axis), -1.0), 1.0)
            true_incidence_deg[s, b] = np.degrees(np.arccos(cosine))


@kernel(outermost=True)
def locate(beams: FloatArray, range_m: FloatArray, point_site_m: FloatArray) -> None:
    """Where the measured range along the published axis ends."""
    for s in range(range_m.shape[0]):
        for b in range(range_m.shape[1]):
            for axis in range(3):
                along_m = range_m[s, b] * beams[PUBLISHED, s, b, axis]
                point_site_m[s, b, axis] = beams[SENSOR, s, b, axis] + along_m
