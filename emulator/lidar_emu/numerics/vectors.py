"""Vector algebra in kernels: a vector is a tuple of three numbers or a row (3,) of an array, and a result is a tuple.

Tuples allocate nothing. `vector_arrays` has the same functions, under the same names, for arrays of vectors.
"""

from __future__ import annotations

from math import sqrt

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel

Vector = tuple[float, float, float]
AnyVector = Vector | FloatArray

_LARGEST = 1e12


@kernel
def vector_at(array: FloatArray, place: int) -> Vector:
    """Vector in an array (n,), starting at an index."""
    return array[place], array[place + 1], array[place + 2]


@kernel
def store(array: FloatArray, place: int, v: Vector) -> None:
    """Store a vector in an array (n,), starting at an index."""
    array[place], array[place + 1], array[place + 2] = v[0], v[1], v[2]


@kernel
def add(a: AnyVector, b: AnyVector) -> Vector:
    """a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def subtract(a: AnyVector, b: AnyVector) -> Vector:
    """a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def scale(factor: float, v: AnyVector) -> Vector:
    """Product of a number and a vector."""
    return factor * v[0], factor * v[1], factor * v[2]


@kernel
def multiply(a: AnyVector, b: AnyVector) -> Vector:
    """Product axis by axis, as of a diagonal matrix and a vector."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@kernel
def dot(a: AnyVector, b: AnyVector) -> float:
    """Scalar product."""
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


@kernel
def cross(a: AnyVector, b: AnyVector) -> Vector:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def norm(v: AnyVector) -> float:
    """Length of a vector."""
    return sqrt(dot(v, v))


@kernel
def nan_to_zero(value: float) -> float:
    """The value, or 0 for NaN."""
    return value if value == value else 0.0


@kernel
def bounded(value: float) -> float:
    """Limit a number to 1e12, far beyond any motion, so that its products are finite; 0 for NaN."""
    return min(max(value, -_LARGEST), _LARGEST) if value == value else 0.0
