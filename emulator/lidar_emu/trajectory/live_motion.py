"""The motion between truths and beyond the newest, compiled."""

from __future__ import annotations

from math import cos, isnan, sqrt

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.rotations import (
    quaternion_at,
    quaternion_product,
    set_from_quaternion,
    sin_over,
)
from lidar_emu.numerics.vectors import Vector
from lidar_emu.trajectory.curve import piece_at

ROW = 17
"""Numbers of a truth: time in s, position, velocity, acceleration (NaN where unknown), attitude, body rate."""
_POSITION, _VELOCITY, _ACCELERATION, _ATTITUDE, _RATE = 1, 4, 7, 10, 14


@kernel(outermost=True)
def follow(
    rows: FloatArray,
    time_s: FloatArray,
    position_m: FloatArray,
    velocity_mps: FloatArray,
    acceleration_mps2: FloatArray,
    site_from_body: FloatArray,
    body_rate_radps: FloatArray,
) -> None:
    """Fill the fields of a `VehicleState` from truths (n, ROW), oldest first, at least one."""
    for k in range(len(time_s)):
        first = piece_at(rows[:, 0], time_s[k])
        one = position_m[k], velocity_mps[k], acceleration_mps2[k], site_from_body[k], body_rate_radps[k]
        if time_s[k] < rows[0, 0] or first == len(rows) - 1:
            _continue(rows, first, time_s[k], *one)
        else:
            _interpolate(rows[first], rows[first + 1], time_s[k], *one)


@kernel
def _continue(
    rows: FloatArray,
    place: int,
    time_s: float,
    position_m: FloatArray,
    velocity_mps: FloatArray,
    acceleration_mps2: FloatArray,
    site_from_body: FloatArray,
    body_rate_radps: FloatArray,
) -> None:
    """With acceleration and body rate as they are at a truth; an unknown acceleration is that of the last step."""
    row = rows[place]
    since_s = time_s - row[0]
    for axis in range(3):
        speed, growth = row[_VELOCITY + axis], row[_ACCELERATION + axis]
        if isnan(growth):
            before = rows[place - 1] if place > 0 else row
            step_s = row[0] - before[0]
            growth = (speed - before[_VELOCITY + axis]) / step_s if step_s > 0 else 0.0
        position_m[axis] = row[_POSITION + axis] + (speed + 0.5 * growth * since_s) * since_s
        velocity_mps[axis] = speed + growth * since_s
        acceleration_mps2[axis] = growth
        body_rate_radps[axis] = row[_RATE + axis]
    x, y, z = (0.5 * since_s * row[_RATE], 0.5 * since_s * row[_RATE + 1], 0.5 * since_s * row[_RATE + 2])
    half_turn = sqrt(x * x + y * y + z * z)
    shrunk = sin_over(half_turn)
    w, x, y, z = quaternion_product(
        quaternion_at(row, _ATTITUDE), (cos(half_turn), shrunk * x, shrunk * y, shrunk * z)
    )
    _set_unit_matrix(w, x, y, z, site_from_body)


@kernel
def _interpolate(
    a: FloatArray,
    b: FloatArray,
    time_s: float,
    position_m: FloatArray,
    velocity_mps: FloatArray,
    acceleration_mps2: FloatArray,
    site_from_body: FloatArray,
    body_rate_radps: FloatArray,
) -> None:
    """Hermite's curves, which meet both truths; the quaternion's is made unit where it is read."""
    step_s = b[0] - a[0]
    s = (time_s - a[0]) / step_s
    for axis in range(3):
        p, v, g = _POSITION + axis, _VELOCITY + axis, _ACCELERATION + axis
        if isnan(a[g]) or isnan(b[g]):
            motion = _cubic(a[p], b[p], a[v], b[v], s, step_s)
        else:
            motion = _quintic(a[p], b[p], a[v], b[v], a[g], b[g], s, step_s)
        position_m[axis], velocity_mps[axis], acceleration_mps2[axis] = motion
    (aw, ax, ay, az), (bw, bx, by, bz) = quaternion_at(a, _ATTITUDE), quaternion_at(b, _ATTITUDE)
    # q and -q are the same attitude: of the two, the nearer one.
    sign = 1.0 if aw * bw + ax * bx + ay * by + az * bz >= 0 else -1.0
    aw_, ax_, ay_, az_ = quaternion_product(
        (aw, ax, ay, az), (0.0, 0.5 * a[_RATE], 0.5 * a[_RATE + 1], 0.5 * a[_RATE + 2])
    )
    bw_, bx_, by_, bz_ = quaternion_product(
        (bw, bx, by, bz), (0.0, 0.5 * b[_RATE], 0.5 * b[_RATE + 1], 0.5 * b[_RATE + 2])
    )
    w, w_, _ = _cubic(aw, sign * bw, aw_, sign * bw_, s, step_s)
    x, x_, _ = _cubic(ax, sign * bx, ax_, sign * bx_, s, step_s)
    y, y_, _ = _cubic(ay, sign * by, ay_, sign * by_, s, step_s)
    z, z_, _ = _cubic(az, sign * bz, az_, sign * bz_, s, step_s)
    # The rate is the vector part of 2 q* dq/dt; the change of the curve's length is in the scalar part.
    _, rate_x, rate_y, rate_z = quaternion_product((w, -x, -y, -z), (w_, x_, y_, z_))
    twice = 2 / (w * w + x * x + y * y + z * z)
    body_rate_radps[0], body_rate_radps[1], body_rate_radps[2] = (
        twice * rate_x,
        twice * rate_y,
        twice * rate_z,
    )
    _set_unit_matrix(w, x, y, z, site_from_body)


@kernel
def _set_unit_matrix(w: float, x: float, y: float, z: float, matrix: FloatArray) -> None:
    length = sqrt(w * w + x * x + y * y + z * z)
    set_from_quaternion(w / length, x / length, y / length, z / length, matrix)


@kernel
def _cubic(p: float, q: float, p_rate: float, q_rate: float, s: float, step_s: float) -> Vector:
    """Hermite's cubic from p to q at s in 0..1, with its first and second derivative in time."""
    u, w, d = p_rate * step_s, q_rate * step_s, q - p
    c2, c3 = 3 * d - 2 * u - w, u + w - 2 * d
    value = p + s * (u + s * (c2 + s * c3))
    rate = u + s * (2 * c2 + s * 3 * c3)
    return value, rate / step_s, (2 * c2 + 6 * s * c3) / step_s**2


@kernel
def _quintic(
    p: float, q: float, p_rate: float, q_rate: float, p_bend: float, q_bend: float, s: float, step_s: float
) -> Vector:
    """Hermite's quintic, which meets the second derivatives too."""
    u, w, d = p_rate * step_s, q_rate * step_s, q - p
    g, h = 0.5 * p_bend * step_s**2, 0.5 * q_bend * step_s**2
    c3 = 10 * d - 6 * u - 4 * w - 3 * g + h
    c4 = -15 * d + 8 * u + 7 * w + 3 * g - 2 * h
    c5 = 6 * d - 3 * (u + w) - g + h
    value = p + s * (u + s * (g + s * (c3 + s * (c4 + s * c5))))
    rate = u + s * (2 * g + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))
    bend = 2 * g + s * (6 * c3 + s * (12 * c4 + s * 20 * c5))
    return value, rate / step_s, bend / step_s**2
