"""A trajectory that is still being flown: truth as it arrives, interpolated, or continued beyond the newest."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from contextlib import contextmanager
from math import cos, isfinite, sin, sqrt

import numpy as np

from lidar_emu.arrays import FloatArray
from lidar_emu.scenario.schema import LONGEST_S
from lidar_emu.trajectory.live_datagram import Quaternion, Truth, Vector, Verdict
from lidar_emu.trajectory.state import Gap, VehicleState

LONGEST_STEP_NS = 10_000_000_000
_KEPT = 64
_UNIT_TOLERANCE = 1e-3
_Motion = tuple[list[float], list[float], list[float], list[float], list[float]]


class LiveTrajectory:
    """Truth so far. Between two truths position and velocity (and acceleration, where it is known) are met at both,
    and so are attitude and body rate; beyond the newest, acceleration and body rate stay as they are.

    Args:
        jump_m: a truth further than this from where the last was heading starts anew.
    """

    duration_s = LONGEST_S
    gaps: tuple[Gap, ...] = ()

    def __init__(self, jump_m: float) -> None:
        self._jump_m = jump_m
        self._truths: deque[Truth] = deque(maxlen=_KEPT)
        self.verdicts: Counter[Verdict] = Counter()
        self.jumped = 0
        self.lost = 0
        """Numbers that never arrived, or arrived out of order."""

    @property
    def newest(self) -> Truth | None:
        """The truth that later ones follow."""
        return self._truths[-1] if self._truths else None

    def accept(self, truth: Truth | None, now_ns: int | None) -> Verdict:
        """Take a truth into account, or count why not.

        Args:
            truth: as decoded; None for bytes that are none.
            now_ns: scenario time; None where only truth makes it pass, and until it has begun.
        """
        verdict = self._judge(truth, now_ns)
        self.verdicts[verdict] += 1
        if verdict is Verdict.ACCEPTED and truth is not None:
            self._take(truth)
        return verdict

    @contextmanager
    def pretending(self, truth: Truth) -> Iterator[None]:
        """As if this were all that is known."""
        kept = list(self._truths)
        self._truths.clear()
        self._truths.append(truth)
        try:
            yield
        finally:
            self._truths.clear()
            self._truths.extend(kept)

    def state(self, time_s: FloatArray) -> VehicleState:
        """The vehicle at scenario times (n,), as near as the truth so far tells.

        Raises:
            ValueError: there is no truth yet.
        """
        instants_s = time_s.tolist()
        known = {instant_s: self._at(instant_s) for instant_s in set(instants_s)}
        columns = zip(*(known[instant_s] for instant_s in instants_s), strict=True)
        position, velocity, acceleration, attitude, rate = (np.array(column) for column in columns)
        return VehicleState(time_s, position, velocity, acceleration, attitude.reshape(-1, 3, 3), rate)

    def _judge(self, truth: Truth | None, now_ns: int | None) -> Verdict:
        if truth is None:
            return Verdict.MALFORMED
        acceleration = truth.acceleration_site_mps2 or ()
        values = (*truth.position_site_m, *truth.velocity_site_mps, *acceleration, *truth.body_rate_radps)
        if not all(map(isfinite, (*values, *truth.site_from_body))):
            return Verdict.NOT_FINITE
        if abs(sum(q * q for q in truth.site_from_body) - 1) > 2 * _UNIT_TOLERANCE:
            return Verdict.BAD_ATTITUDE
        newest = self.newest
        if now_ns is not None and abs(truth.time_ns - now_ns) > LONGEST_STEP_NS:
            return Verdict.IMPLAUSIBLE_TIME
        if newest is None:
            return Verdict.ACCEPTED
        if truth.time_ns == newest.time_ns:
            return Verdict.DUPLICATE
        if truth.time_ns < newest.time_ns:
            return Verdict.OUT_OF_ORDER
        if now_ns is None and truth.time_ns - newest.time_ns > LONGEST_STEP_NS:
            return Verdict.IMPLAUSIBLE_TIME
        return Verdict.ACCEPTED

    def _take(self, truth: Truth) -> None:
        newest = self.newest
        if newest is not None:
            self.lost += max(0, truth.sequence - newest.sequence - 1)
            heading_m = self._at(truth.time_ns * 1e-9)[0]
            away_m2 = sum((a - b) ** 2 for a, b in zip(truth.position_site_m, heading_m, strict=True))
            if away_m2 > self._jump_m**2:
                self.jumped += 1
                self._truths.clear()
        self._truths.append(truth)

    def _at(self, time_s: float) -> _Motion:
        if not self._truths:
            raise ValueError("there is no truth yet")
        after = None
        for truth in reversed(self._truths):
            if truth.time_ns * 1e-9 <= time_s:
                return (
                    _continued(truth, self._acceleration(), time_s)
                    if after is None
                    else _between(truth, after, time_s)
                )
            after = truth
        assert after is not None
        return _continued(after, after.acceleration_site_mps2 or (0.0, 0.0, 0.0), time_s)

    def _acceleration(self) -> Vector:
        """At the newest truth: as it says, or as the last two differ."""
        newest = self._truths[-1]
        if newest.acceleration_site_mps2 is not None:
            return newest.acceleration_site_mps2
        if len(self._truths) == 1:
            return 0.0, 0.0, 0.0
        before = self._truths[-2]
        step_s = (newest.time_ns - before.time_ns) * 1e-9
        x, y, z = (
            (b - a) / step_s for a, b in zip(before.velocity_site_mps, newest.velocity_site_mps, strict=True)
        )
        return x, y, z


def _continued(truth: Truth, acceleration: Vector, time_s: float) -> _Motion:
    since_s = time_s - truth.time_ns * 1e-9
    position = [
        p + (v + 0.5 * a * since_s) * since_s
        for p, v, a in zip(truth.position_site_m, truth.velocity_site_mps, acceleration, strict=True)
    ]
    velocity = [v + a * since_s for v, a in zip(truth.velocity_site_mps, acceleration, strict=True)]
    turned = _turned(truth.site_from_body, truth.body_rate_radps, since_s)
    return position, velocity, list(acceleration), _matrix(turned), list(truth.body_rate_radps)


def _between(a: Truth, b: Truth, time_s: float) -> _Motion:
    start_s = a.time_ns * 1e-9
    step_s = (b.time_ns - a.time_ns) * 1e-9
    s = (time_s - start_s) / step_s
    moved = [_motion(a, b, axis, s, step_s) for axis in range(3)]
    position, velocity, acceleration = (list(column) for column in zip(*moved, strict=True))
    sign = 1.0 if sum(x * y for x, y in zip(a.site_from_body, b.site_from_body, strict=True)) >= 0 else -1.0
    end = tuple(sign * q for q in b.site_from_body)
    first, last = _rate_of(a.site_from_body, a.body_rate_radps), _rate_of(end, b.body_rate_radps)
    read = [_cubic(*knots, s, step_s) for knots in zip(a.site_from_body, end, first, last, strict=True)]
    q, q_rate, _ = zip(*read, strict=True)
    squared = sum(x * x for x in q)
    length = sqrt(squared)
    return (
        position,
        velocity,
        acceleration,
        _matrix(tuple(x / length for x in q)),
        _body_rate(q, q_rate, squared),
    )


def _motion(a: Truth, b: Truth, axis: int, s: float, step_s: float) -> tuple[float, float, float]:
    ends = (
        a.position_site_m[axis], b.position_site_m[axis], a.velocity_site_mps[axis], b.velocity_site_mps[axis]
    )  # fmt: skip
    if a.acceleration_site_mps2 is None or b.acceleration_site_mps2 is None:
        return _cubic(*ends, s, step_s)
    return _quintic(*ends, a.acceleration_site_mps2[axis], b.acceleration_site_mps2[axis], s, step_s)


def _cubic(
    p: float, q: float, p_rate: float, q_rate: float, s: float, step_s: float
) -> tuple[float, float, float]:
    """Hermite's cubic from p to q at s in 0..1, with its first and second derivative in time."""
    u, w, d = p_rate * step_s, q_rate * step_s, q - p
    c2, c3 = 3 * d - 2 * u - w, u + w - 2 * d
    value = p + s * (u + s * (c2 + s * c3))
    rate = u + s * (2 * c2 + s * 3 * c3)
    return value, rate / step_s, (2 * c2 + 6 * s * c3) / step_s**2


def _quintic(
    p: float, q: float, p_rate: float, q_rate: float, p_bend: float, q_bend: float, s: float, step_s: float
) -> tuple[float, float, float]:
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


def _turned(q: Quaternion, rate: Vector, since_s: float) -> Quaternion:
    """q exp(rate t / 2), made unit."""
    x, y, z = (0.5 * since_s * r for r in rate)
    half = sqrt(x * x + y * y + z * z)
    shrink = sin(half) / half if half > 0 else 1.0
    turn = (cos(half), shrink * x, shrink * y, shrink * z)
    w, i, j, k = _times(q, turn)
    length = sqrt(w * w + i * i + j * j + k * k)
    return w / length, i / length, j / length, k / length


def _times(a: tuple[float, ...], b: tuple[float, ...]) -> Quaternion:
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def _rate_of(q: tuple[float, ...], rate: Vector) -> Quaternion:
    """dq/dt = q (0, rate) / 2."""
    w, x, y, z = _times(q, (0.0, *rate))
    return w / 2, x / 2, y / 2, z / 2


def _body_rate(q: tuple[float, ...], q_rate: tuple[float, ...], squared: float) -> list[float]:
    """The vector part of 2 q* dq/dt; the change of the curve's length is in the scalar part."""
    w, x, y, z = q
    return [2 * part / squared for part in _times((w, -x, -y, -z), q_rate)[1:]]


def _matrix(unit: tuple[float, ...]) -> list[float]:
    """Rotation matrix, row by row."""
    w, x, y, z = unit
    return [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
