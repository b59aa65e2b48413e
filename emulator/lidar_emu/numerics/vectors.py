"""Vectors and quaternions as tuples of numbers: kernels pass them on without allocating anything."""

from __future__ import annotations

from math import sqrt

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@kernel
def vector_at(array: FloatArray, place: int) -> Vector:
    """The three numbers of an array (n,) from a place on."""
    return array[place], array[place + 1], array[place + 2]


@kernel
def quaternion_at(array: FloatArray, place: int) -> Quaternion:
    return array[place], array[place + 1], array[place + 2], array[place + 3]


@kernel
def put(array: FloatArray, place: int, v: Vector) -> None:
    array[place], array[place + 1], array[place + 2] = v[0], v[1], v[2]


@kernel
def plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def times(factor: float, v: Vector) -> Vector:
    return factor * v[0], factor * v[1], factor * v[2]


@kernel
def each(a: Vector, b: Vector) -> Vector:
    """Product axis by axis: a diagonal matrix on a vector."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@kernel
def inner(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def outer(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def length(v: Vector) -> float:
    return sqrt(inner(v, v))


@kernel
def parent_of(q: Quaternion, v: Vector) -> Vector:
    """A vector of the child frame in the parent frame, by the unit quaternion parent_from_child."""
    axis = (q[1], q[2], q[3])
    twice = times(2.0, outer(axis, v))
    return plus(v, plus(times(q[0], twice), outer(axis, twice)))


@kernel
def child_of(q: Quaternion, v: Vector) -> Vector:
    """A vector of the parent frame in the child frame."""
    return parent_of((q[0], -q[1], -q[2], -q[3]), v)


@kernel
def turning(q: Quaternion, rate: Vector) -> Quaternion:
    """q (0, rate) / 2: the derivative of parent_from_child at a rate about the child's axes."""
    return (
        -0.5 * (q[1] * rate[0] + q[2] * rate[1] + q[3] * rate[2]),
        0.5 * (q[0] * rate[0] + q[2] * rate[2] - q[3] * rate[1]),
        0.5 * (q[0] * rate[1] + q[3] * rate[0] - q[1] * rate[2]),
        0.5 * (q[0] * rate[2] + q[1] * rate[1] - q[2] * rate[0]),
    )
