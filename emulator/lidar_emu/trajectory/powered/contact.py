"""Feet on level ground: damped springs without tension, with friction."""

from __future__ import annotations

from math import inf, sqrt

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.rotations import quaternion_at, to_child, to_parent
from lidar_emu.numerics.vectors import Vector, add, cross, vector_at
from lidar_emu.trajectory.powered.vehicle import ATTITUDE, POSITION, RATE, VELOCITY, VehicleConstants

SLIDING_MPS = 0.02
"""Below this speed friction is proportional to it."""


@kernel
def lowest_foot_m(body: VehicleConstants, state: FloatArray) -> float:
    """Height of the lowest foot above the ground; negative while the spring is compressed."""
    turn, lowest = quaternion_at(state, ATTITUDE), inf
    for foot in range(len(body.feet_m)):
        lowest = min(lowest, to_parent(turn, vector_at(body.feet_m[foot], 0))[2])
    height_m: float = state[POSITION + 2] + lowest - body.ground_m
    return height_m


@kernel
def ground_reaction(body: VehicleConstants, state: FloatArray) -> tuple[Vector, Vector]:
    """Force in the site frame and torque about the body's axes.

    A foot's force is k d (1 + c d') with depth d (Hunt and Crossley, 1975): it starts from 0, and the power that it
    dissipates, k c d d'^2, is never negative.
    """
    turn, rate = quaternion_at(state, ATTITUDE), vector_at(state, RATE)
    velocity = vector_at(state, VELOCITY)
    force, torque = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for i in range(len(body.feet_m)):
        foot = vector_at(body.feet_m[i], 0)
        depth_m = body.ground_m - state[POSITION + 2] - to_parent(turn, foot)[2]
        if depth_m > 0.0:
            moving = add(velocity, to_parent(turn, cross(rate, foot)))
            normal = max(0.0, body.stiffness_npm * depth_m * (1.0 - body.foot_damping_spm * moving[2]))
            sliding = sqrt(moving[0] * moving[0] + moving[1] * moving[1])
            friction_nspm = body.friction * normal / max(sliding, SLIDING_MPS)
            push = (-friction_nspm * moving[0], -friction_nspm * moving[1], normal)
            force, torque = add(force, push), add(torque, cross(foot, to_child(turn, push)))
    return force, torque
