"""Pointing of the beams, and kernels that compute it from the motion of the vehicle."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import add, cross, dot, nan_to_zero, rotate, store, to_quaternion
from lidar_emu.trajectory.profile import VehicleState

DIRECTION = np.dtype([("true_body", float, 3), ("published_body", float, 3), ("angle_deg", float)])
"""A beam of a pattern: true and published unit vectors in the body frame, and its published off-boresight angle."""


class BeamVectors(NamedTuple):
    """The vectors of beams in the site frame, (shots, beams, 3) each."""

    sensor_m: FloatArray
    """Centre of the aperture."""
    velocity_mps: FloatArray
    """Velocity of the sensor, including the body's rotation about the lever arm."""
    acceleration_mps2: FloatArray
    """Acceleration of the sensor, including the body's rotation and angular acceleration about the lever arm."""
    turning_radps: FloatArray
    """Angular rate of the body and its beams."""
    true: FloatArray
    """Unit vectors along the true beam axes."""
    published: FloatArray
    """Unit vectors along the beam axes that packets publish."""


@kernel
def beam_vectors(stacked: FloatArray) -> BeamVectors:
    """Name the vectors (6, shots, beams, 3) of `Pointing.beams`."""
    return BeamVectors(stacked[0], stacked[1], stacked[2], stacked[3], stacked[4], stacked[5])


class ChirpBeams(NamedTuple):
    """The vectors of beams in the site frame at the centres of the up-chirp's and the down-chirp's record, (2, shots,
    beams, 3) each: with those at the time of validity they follow the motion through a measurement."""

    sensor_m: FloatArray
    velocity_mps: FloatArray
    true: FloatArray


@kernel
def chirp_beams(stacked: FloatArray) -> ChirpBeams:
    """Name the vectors (3, 2, shots, beams, 3) of `Pointing.at_chirps`."""
    return ChirpBeams(stacked[0], stacked[1], stacked[2])


class Pointing(NamedTuple):
    """Origins and directions of the beams; arrays are (shots, beams) and (shots, beams, 3), NaN for absent beams."""

    shot: NDArray[np.int64]
    """(shots,)"""
    pattern: NDArray[np.int64]
    """(shots,) Number of the beam pattern in use."""
    time_ns: NDArray[np.int64]
    in_gap: BoolArray
    """Whether the vehicle's position is bridged over a gap in the trajectory table."""
    fired: BoolArray
    angle_deg: FloatArray
    beams: FloatArray
    """(6, shots, beams, 3) The arrays of `BeamVectors`, stacked: passing one array to a kernel is faster than six."""
    vehicle: FloatArray
    """(4, shots, 3) Position, velocity, acceleration, and angular rate about the body's axes, at the first beam's time
    of validity."""
    site_from_body: FloatArray
    """(shots, 4) Attitude at that time: unit quaternion w, x, y, z with w >= 0."""
    at_chirps: FloatArray
    """(3, 2, shots, beams, 3) The arrays of `ChirpBeams`, stacked; empty where the run leaves curvature of the motion
    out."""

    @classmethod
    def unfilled(cls, shot: NDArray[np.int64], beams: int, follows_chirps: bool = False) -> Self:
        """Empty arrays for these shots of `beams` beams.

        Args:
            follows_chirps: whether to allocate `at_chirps`.
        """
        shape = len(shot), beams
        return cls(
            shot=shot,
            pattern=np.empty(len(shot), dtype=np.int64),
            time_ns=np.empty(shape, dtype=np.int64),
            in_gap=np.zeros(shape, dtype=np.bool_),
            fired=np.empty(shape, dtype=np.bool_),
            angle_deg=np.empty(shape),
            beams=np.empty((6, *shape, 3)),
            vehicle=np.empty((4, len(shot), 3)),
            site_from_body=np.empty((len(shot), 4)),
            at_chirps=np.empty((3, 2, *shape, 3) if follows_chirps else (3, 2, 0, 0, 3)),
        )

    @property
    def sensor_site_m(self) -> FloatArray:
        return BeamVectors(*self.beams).sensor_m

    @property
    def sensor_velocity_site_mps(self) -> FloatArray:
        return BeamVectors(*self.beams).velocity_mps

    @property
    def turning_site_radps(self) -> FloatArray:
        return BeamVectors(*self.beams).turning_radps

    @property
    def true_site(self) -> FloatArray:
        return BeamVectors(*self.beams).true

    @property
    def published_site(self) -> FloatArray:
        return BeamVectors(*self.beams).published

    def vehicle_columns(self) -> dict[str, Any]:
        """The vehicle's columns of a measurement, by name."""
        position_m, velocity_mps, acceleration_mps2, body_rate_radps = self.vehicle
        return {
            "position_site_m": position_m,
            "velocity_site_mps": velocity_mps,
            "acceleration_site_mps2": acceleration_mps2,
            "site_from_body": self.site_from_body,
            "body_rate_radps": body_rate_radps,
        }


@kernel(outermost=True)
def set_times(
    shot: NDArray[np.int64],
    period_ns: int,
    validity_ns: IntArray,
    time_ns: IntArray,
    instant_s: FloatArray,
) -> None:
    """Set times of validity (shots, beams), and instants (shots, 1 + beams): the shot's start, then the beams'."""
    for s in range(len(shot)):
        start_ns = shot[s] * period_ns
        instant_s[s, 0] = start_ns * 1e-9
        for b in range(len(validity_ns)):
            time_ns[s, b] = start_ns + validity_ns[b]
            instant_s[s, 1 + b] = time_ns[s, b] * 1e-9


@kernel(outermost=True)
def set_chirp_times(time_ns: IntArray, segment_s: float, time_s: FloatArray) -> None:
    """Set the times (2, shots, beams) of the centres of the up-chirp's and the down-chirp's record."""
    for s in range(time_ns.shape[0]):
        for b in range(time_ns.shape[1]):
            valid_s = time_ns[s, b] * 1e-9
            time_s[0, s, b], time_s[1, s, b] = valid_s - segment_s, valid_s + segment_s


@kernel(outermost=True)
def place_starts(
    instant_s: FloatArray,
    position_m: FloatArray,
    site_from_body: FloatArray,
    lever_arm_m: FloatArray,
    starts: FloatArray,
) -> None:
    """Set time and sensor position (4, shots) at the first of each shot's instants."""
    for s in range(starts.shape[1]):
        starts[0, s] = instant_s[s, 0]
        k = s * instant_s.shape[1]
        for axis in range(3):
            starts[1 + axis, s] = position_m[k, axis] + dot(site_from_body[k, axis], lever_arm_m)


Chosen = tuple[IntArray, IntArray, int]
"""Numbers and patterns of shots (shots,), and the steps of a scan: a pattern has a row of directions for each."""


@kernel
def _row(chosen: Chosen, s: int) -> int:
    shot, pattern, steps = chosen
    return int(pattern[s] * steps + shot[s] % steps)


@kernel(outermost=True)
def point_beams(
    state_arrays: tuple[Any, ...],
    lever_arm_m: FloatArray,
    chosen: Chosen,
    directions: Any,
    fired: BoolArray,
    angle_deg: FloatArray,
    stacked: FloatArray,
    vehicle: FloatArray,
    site_from_body: FloatArray,
) -> None:
    """Fill the arrays of `Pointing` that depend on the motion of the vehicle.

    The lever arm r turns with the body: the sensor's position, velocity and acceleration gain r, ω x r and
    ω x (ω x r) + dω/dt x r.

    Args:
        state_arrays: Arrays of a `VehicleState` at 1 + beams instants of each shot, the first unused.
        lever_arm_m: (3,) Position of the sensor in the body frame.
        chosen: which row of the directions each shot uses.
        directions: (rows, beams) of `DIRECTION`.
        fired, angle_deg: (shots, beams), see `Pointing`.
        stacked: (6, shots, beams, 3), see `Pointing.beams`.
        vehicle, site_from_body: see `Pointing`.
    """
    state, vectors = VehicleState(*state_arrays), beam_vectors(stacked)
    position_m, velocity_mps = state.position_site_m, state.velocity_site_mps
    shots, beams = fired.shape
    for s in range(shots):
        row = _row(chosen, s)
        for b in range(beams):
            k, direction = s * (1 + beams) + 1 + b, directions[row, b]
            rotation = state.site_from_body[k]
            turning = rotate(rotation, state.body_rate_radps[k])
            lever_arm = rotate(rotation, lever_arm_m)
            swing = cross(turning, lever_arm)
            store(vectors.turning_radps[s, b], 0, turning)
            store(vectors.sensor_m[s, b], 0, add(lever_arm, position_m[k]))
            store(vectors.velocity_mps[s, b], 0, add(swing, velocity_mps[k]))
            swinging = rotate(rotation, state.angular_acceleration_body_radps2[k])
            turned = add(cross(turning, swing), cross(swinging, lever_arm))
            store(vectors.acceleration_mps2[s, b], 0, add(turned, state.acceleration_site_mps2[k]))
            store(vectors.true[s, b], 0, rotate(rotation, direction.true_body))
            store(vectors.published[s, b], 0, rotate(rotation, direction.published_body))
            angle_deg[s, b] = direction.angle_deg
            fired[s, b] = angle_deg[s, b] == angle_deg[s, b]
        k = s * (1 + beams) + 1
        for axis in range(3):
            vehicle[0, s, axis] = position_m[k, axis]
            vehicle[1, s, axis] = velocity_mps[k, axis]
            vehicle[2, s, axis] = state.acceleration_site_mps2[k, axis]
            vehicle[3, s, axis] = state.body_rate_radps[k, axis]
        w, x, y, z = to_quaternion(state.site_from_body[k])
        site_from_body[s, 0] = w
        store(site_from_body[s], 1, (x, y, z))


@kernel(outermost=True)
def follow_beams(
    state_arrays: tuple[Any, ...],
    lever_arm_m: FloatArray,
    chosen: Chosen,
    directions: Any,
    stacked: FloatArray,
) -> None:
    """Fill `Pointing.at_chirps`.

    Args:
        state_arrays: Arrays of a `VehicleState` at the (2, shots, beams) instants of the chirps, in this order.
        lever_arm_m, chosen, directions: see `point_beams`.
        stacked: (3, 2, shots, beams, 3), see `Pointing.at_chirps`.
    """
    state, vectors = VehicleState(*state_arrays), chirp_beams(stacked)
    _, shots, beams, _ = vectors.sensor_m.shape
    for chirp in range(2):
        for s in range(shots):
            row = _row(chosen, s)
            for b in range(beams):
                k = (chirp * shots + s) * beams + b
                rotation = state.site_from_body[k]
                lever_arm = rotate(rotation, lever_arm_m)
                swing = cross(rotate(rotation, state.body_rate_radps[k]), lever_arm)
                store(vectors.sensor_m[chirp, s, b], 0, add(lever_arm, state.position_site_m[k]))
                store(vectors.velocity_mps[chirp, s, b], 0, add(swing, state.velocity_site_mps[k]))
                store(vectors.true[chirp, s, b], 0, rotate(rotation, directions[row, b].true_body))


class BeamTruth(NamedTuple):
    """Columns of a measurement that follow from pointing, hits and ranges, (shots, beams) or (shots, beams, 3)."""

    due_ns: IntArray
    """(shots,)"""
    pattern: NDArray[np.uint8]
    """(shots,)"""
    true_closing_speed_mps: FloatArray
    true_incidence_deg: FloatArray
    """NaN where a beam has no hit."""
    point_site_m: FloatArray
    true_point_site_m: FloatArray
    true_sensor_site_m: FloatArray
    true_beam_axis_site: FloatArray
    beam_axis_body: FloatArray

    @classmethod
    def unfilled(cls, shots: int, beams: int) -> Self:
        """Allocate arrays for a kernel to fill."""
        each, vector = (shots, beams), (shots, beams, 3)
        return cls(
            np.empty(shots, dtype=np.int64),
            np.empty(shots, dtype=np.uint8),
            np.empty(each),
            np.empty(each),
            *(np.empty(vector) for _ in range(5)),
        )


@kernel(outermost=True)
def set_beam_truth(
    chosen: Chosen,
    period_ns: int,
    latency_ns: int,
    directions: Any,
    stacked: FloatArray,
    hit_arrays: tuple[FloatArray, FloatArray, FloatArray],
    range_m: FloatArray,
    truth_arrays: tuple[Any, ...],
) -> None:
    """Fill the arrays of `BeamTruth`.

    The closing speed is the sensor's speed along the true axis minus the hit surface's.

    Args:
        chosen, directions, stacked: see `point_beams`.
        hit_arrays: ranges, normals and surface velocities, empty in a static scene, of the axes' `Hits`.
        range_m: measured ranges.
    """
    beams, truth = beam_vectors(stacked), BeamTruth(*truth_arrays)
    true_closing_mps, true_incidence_deg = truth.true_closing_speed_mps, truth.true_incidence_deg
    true_range_m, normals, surface_mps = hit_arrays
    for s in range(true_closing_mps.shape[0]):
        row = _row(chosen, s)
        truth.due_ns[s] = chosen[0][s] * period_ns + latency_ns
        truth.pattern[s] = chosen[1][s]
        for b in range(true_closing_mps.shape[1]):
            sensor_m, axis = beams.sensor_m[s, b], beams.true[s, b]
            published, body = beams.published[s, b], directions[row, b].published_body
            for side in range(3):
                truth.true_sensor_site_m[s, b, side] = sensor_m[side]
                truth.true_beam_axis_site[s, b, side] = axis[side]
                truth.beam_axis_body[s, b, side] = body[side]
                along_m = range_m[s, b] * published[side]
                truth.point_site_m[s, b, side] = sensor_m[side] + along_m
                along_m = true_range_m[s, b] * axis[side]
                truth.true_point_site_m[s, b, side] = sensor_m[side] + along_m
            true_closing_mps[s, b] = dot(beams.velocity_mps[s, b], axis)
            if surface_mps.size > 0:
                true_closing_mps[s, b] -= nan_to_zero(dot(surface_mps[s, b], axis))
            # Bounds first: np.minimum passes NaN on, min() may not.
            cosine = np.minimum(np.maximum(-dot(normals[s, b], axis), -1.0), 1.0)
            true_incidence_deg[s, b] = np.degrees(np.arccos(cosine))
