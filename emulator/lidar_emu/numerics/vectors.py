"""Vectors, rotations and a sine in kernels.

Tuples allocate nothing. `vector_arrays` has the same functions, under the same names, for arrays of vectors.

Matrices are named target_from_source: columns are the source's axes in the target frame. Sums are written out element
by element, as in `vector_arrays`, which has the functions for arrays of rotations.
"""

from __future__ import annotations

from math import cos, factorial, pi, sin, sqrt

import numpy as np

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


Quaternion = tuple[float, float, float, float]


@kernel
def rotate(target_from_source: FloatArray, source: AnyVector) -> Vector:
    """Rotate a vector from the source frame to the target frame."""
    m, x, y, z = target_from_source, source[0], source[1], source[2]
    return (
        m[0, 0] * x + m[0, 1] * y + m[0, 2] * z,
        m[1, 0] * x + m[1, 1] * y + m[1, 2] * z,
        m[2, 0] * x + m[2, 1] * y + m[2, 2] * z,
    )


@kernel
def premultiply(target_from_middle: FloatArray, rotation: FloatArray) -> None:
    """Compose with a rotation in place: middle_from_source (3, 3) becomes target_from_source."""
    for column in range(3):
        x, y, z = rotation[0, column], rotation[1, column], rotation[2, column]
        for row in range(3):
            turn = target_from_middle[row]
            rotation[row, column] = turn[0] * x + turn[1] * y + turn[2] * z


@kernel
def set_from_yaw_pitch_roll(yaw_rad: float, pitch_rad: float, roll_rad: float, matrix: FloatArray) -> None:
    """Set parent_from_child (3, 3) from the aerospace sequence: about z, then y, then x."""
    sin_yaw, cos_yaw = sin(yaw_rad), cos(yaw_rad)
    sin_pitch, cos_pitch = sin(pitch_rad), cos(pitch_rad)
    sin_roll, cos_roll = sin(roll_rad), cos(roll_rad)
    matrix[0, 0] = cos_yaw * cos_pitch
    matrix[0, 1] = cos_yaw * sin_pitch * sin_roll - sin_yaw * cos_roll
    matrix[0, 2] = cos_yaw * sin_pitch * cos_roll + sin_yaw * sin_roll
    matrix[1, 0] = sin_yaw * cos_pitch
    matrix[1, 1] = sin_yaw * sin_pitch * sin_roll + cos_yaw * cos_roll
    matrix[1, 2] = sin_yaw * sin_pitch * cos_roll - cos_yaw * sin_roll
    matrix[2, 0] = -sin_pitch
    matrix[2, 1] = cos_pitch * sin_roll
    matrix[2, 2] = cos_pitch * cos_roll


@kernel
def set_from_rotation_vector(x_rad: float, y_rad: float, z_rad: float, matrix: FloatArray) -> None:
    """Set exp([v]x), (3, 3), by Rodrigues' formula.

    sin(a)/a and (1 - cos a)/a² = (sin(a/2)/(a/2))²/2 are finite at a = 0, so that no rotation is a special case.
    """
    angle_rad = sqrt(x_rad * x_rad + y_rad * y_rad + z_rad * z_rad)
    first, half, cosine = sin_over(angle_rad), sin_over(0.5 * angle_rad), cos(angle_rad)
    second = 0.5 * half * half
    matrix[0, 0] = cosine + second * x_rad * x_rad
    matrix[1, 1] = cosine + second * y_rad * y_rad
    matrix[2, 2] = cosine + second * z_rad * z_rad
    matrix[0, 1] = second * x_rad * y_rad - first * z_rad
    matrix[1, 0] = second * x_rad * y_rad + first * z_rad
    matrix[0, 2] = second * x_rad * z_rad + first * y_rad
    matrix[2, 0] = second * x_rad * z_rad - first * y_rad
    matrix[1, 2] = second * y_rad * z_rad - first * x_rad
    matrix[2, 1] = second * y_rad * z_rad + first * x_rad


@kernel
def sin_over(angle_rad: float) -> float:
    """sin(a) / a, which is 1 at a = 0."""
    return sin(angle_rad) / angle_rad if angle_rad > 0.0 else 1.0


@kernel
def set_from_quaternion(w: float, x: float, y: float, z: float, matrix: FloatArray) -> None:
    """Set parent_from_child (3, 3) from a unit quaternion parent_from_child."""
    matrix[0, 0] = 1 - 2 * (y * y + z * z)
    matrix[0, 1] = 2 * (x * y - w * z)
    matrix[0, 2] = 2 * (x * z + w * y)
    matrix[1, 0] = 2 * (x * y + w * z)
    matrix[1, 1] = 1 - 2 * (x * x + z * z)
    matrix[1, 2] = 2 * (y * z - w * x)
    matrix[2, 0] = 2 * (x * z - w * y)
    matrix[2, 1] = 2 * (y * z + w * x)
    matrix[2, 2] = 1 - 2 * (x * x + y * y)


@kernel
def to_quaternion(parent_from_child: FloatArray) -> Quaternion:
    """Unit quaternion with w >= 0 of a rotation (3, 3), from whichever component is largest (Shepperd, 1978)."""
    m = parent_from_child
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    if trace >= max(m[0, 0], m[1, 1], m[2, 2]):
        q = (1 + trace, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1])
    elif m[0, 0] >= max(m[1, 1], m[2, 2]):
        q = (m[2, 1] - m[1, 2], 1 + m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2])
    elif m[1, 1] >= m[2, 2]:
        q = (m[0, 2] - m[2, 0], m[1, 0] + m[0, 1], 1 + m[1, 1] - m[2, 2] - m[0, 0], m[2, 1] + m[1, 2])
    else:
        q = (m[1, 0] - m[0, 1], m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], 1 + m[2, 2] - m[0, 0] - m[1, 1])
    length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    length = -length if q[0] < 0.0 else length
    return q[0] / length, q[1] / length, q[2] / length, q[3] / length


@kernel
def quaternion_at(array: FloatArray, place: int) -> Quaternion:
    """Quaternion in an array (n,), starting at an index."""
    return array[place], array[place + 1], array[place + 2], array[place + 3]


@kernel
def quaternion_product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton's product: the rotation b followed by the rotation a."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


@kernel
def to_parent(parent_from_child: Quaternion, v: Vector) -> Vector:
    """Rotate a vector from the child frame to the parent frame, by a unit quaternion."""
    q = parent_from_child
    axis = (q[1], q[2], q[3])
    twice = scale(2.0, cross(axis, v))
    return add(v, add(scale(q[0], twice), cross(axis, twice)))


@kernel
def to_child(parent_from_child: Quaternion, v: Vector) -> Vector:
    """Rotate a vector from the parent frame to the child frame, by a unit quaternion."""
    q = parent_from_child
    return to_parent((q[0], -q[1], -q[2], -q[3]), v)


@kernel
def quaternion_rate(q: Quaternion, rate: Vector) -> Quaternion:
    """q (0, rate) / 2: the derivative of parent_from_child at an angular rate (rad/s) about the child's axes."""
    return (
        -0.5 * (q[1] * rate[0] + q[2] * rate[1] + q[3] * rate[2]),
        0.5 * (q[0] * rate[0] + q[2] * rate[2] - q[3] * rate[1]),
        0.5 * (q[0] * rate[1] + q[3] * rate[0] - q[1] * rate[2]),
        0.5 * (q[0] * rate[2] + q[1] * rate[1] - q[2] * rate[0]),
    )


@kernel
def angular_motion(q: Quaternion, slope: Quaternion, bend: Quaternion) -> tuple[Vector, Vector]:
    """Angular rate in rad/s and its derivative in rad/s², about the child's axes, of a curve of quaternions of any
    length.

    The rate is ω = vec(2 q* dq/dt) / |q|²; the scalar part of the product holds the change of length. Its derivative is
    vec(2 q* d²q/dt²) / |q|² less the rate times the relative change of |q|², because (dq/dt)* dq/dt is a scalar.

    Args:
        q: parent_from_child.
        slope, bend: first and second derivative in time.
    """
    squared = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    along = q[0] * slope[0] + q[1] * slope[1] + q[2] * slope[2] + q[3] * slope[3]
    rate = _twice_conjugate_vector(q, slope, squared)
    return rate, subtract(_twice_conjugate_vector(q, bend, squared), scale(2.0 * along / squared, rate))


@kernel
def _twice_conjugate_vector(q: Quaternion, p: Quaternion, squared: float) -> Vector:
    """Vector part of 2 q* p, over |q|²."""
    w, x, y, z = q
    dw, dx, dy, dz = p
    return (
        2 * (w * dx - dw * x - (y * dz - z * dy)) / squared,
        2 * (w * dy - dw * y - (z * dx - x * dz)) / squared,
        2 * (w * dz - dw * z - (x * dy - y * dx)) / squared,
    )


FAST = {"nsz"}
"""Fast-math flags of kernels. None changes the order of a sum or the meaning of NaN, and none depends on the code
around a kernel: a process that compiles uses other copies of kernels than a process that loads them from the cache, and
with contracted multiplications and additions the two would differ in the last digits."""

_A1, _A3, _A5, _A7, _A9, _A11, _A13, _A15, _A17, _A19, _A21 = (
    (-1) ** (n // 2) * pi**n / factorial(n) for n in range(1, 22, 2)
)


@kernel(fastmath=FAST)
def sin_pi(x: float) -> float:
    """sin(pi x) for |x| up to slightly above 1/2, relative error 3e-16.

    Taylor series: the next term is 2e-18 at x = 1/2. The odd form keeps the relative error at 0. The two halves of the
    polynomial are independent of each other.
    """
    y = x * x
    y3 = y * y * y
    low = _A1 + y * (_A3 + y * (_A5 + y * (_A7 + y * (_A9 + y * _A11))))
    high = _A13 + y * (_A15 + y * (_A17 + y * (_A19 + y * _A21)))
    value: float = x * (low + y3 * y3 * high)
    return value


_S1, _S3, _S5, _S7, _S9, _S11 = (np.float32((-1) ** (n // 2) * pi**n / factorial(n)) for n in range(1, 12, 2))


@kernel(fastmath=FAST)
def single_sin_pi(x: np.float32) -> np.float32:
    """sin(pi x) for |x| up to 1/2 in single precision, relative error 2e-7; see `sin_pi`."""
    y = x * x
    value: np.float32 = x * (_S1 + y * (_S3 + y * (_S5 + y * (_S7 + y * (_S9 + y * _S11)))))
    return value
