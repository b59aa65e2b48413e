"""A trajectory from live truth, interpolated between samples and extrapolated beyond the newest."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from math import cos, dist, isfinite, isnan, nan, sqrt
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel, with_fields
from lidar_emu.numerics.vectors import (
    Quaternion,
    Vector,
    angular_motion,
    quaternion_at,
    quaternion_product,
    quaternion_rate,
    set_from_quaternion,
    sin_over,
    store,
    vector_at,
)
from lidar_emu.scenario.schema import LONGEST_S
from lidar_emu.trajectory.curves import piece_at
from lidar_emu.trajectory.live_datagram import Truth, Verdict
from lidar_emu.trajectory.profile import Trajectory, VehicleState

TRUTH = np.dtype(
    [
        ("time_s", float),
        ("position_m", float, 3),
        ("velocity_mps", float, 3),
        ("acceleration_mps2", float, 3),
        ("site_from_body", float, 4),
        ("body_rate_radps", float, 3),
    ]
)
"""A truth for kernels, in the site frame; attitude is a quaternion, an unknown acceleration NaN."""
_NUMBERS = Struct(f"{TRUTH.itemsize // 8}d")


@kernel(outermost=True)
def follow(kept: NDArray[np.void], count: IntArray, state_arrays: tuple[Any, ...]) -> None:
    """Fill the arrays of a `VehicleState` at its times from the first truths of `TRUTH`, oldest first, at least one.

    Args:
        count: (1,) number of truths.
    """
    vehicle, truths = VehicleState(*state_arrays), kept[: count[0]]
    time_s = vehicle.time_s
    for k in range(len(time_s)):
        first = piece_at(truths.time_s, time_s[k])  # type: ignore[attr-defined]
        if time_s[k] < truths[0].time_s or first == len(truths) - 1:
            _continue(truths, first, vehicle, k)
        else:
            _interpolate(truths[first], truths[first + 1], vehicle, k)


@kernel
def _continue(truths: NDArray[np.void], place: int, vehicle: VehicleState, k: int) -> None:
    """Continue from a truth with its acceleration, body rate and angular acceleration.

    An unknown acceleration is the mean over the step from the truth before. The angular acceleration, which no truth
    states, is the one at the end of the curve from the truth before. It acts for the length of that step: from then
    on the body rate is constant, so that a vehicle without new truth does not spin up.
    """
    truth = truths[place]
    since_s = vehicle.time_s[k] - truth.time_s
    swing_s, bend = 0.0, (0.0, 0.0, 0.0)
    if place > 0 and since_s >= 0:
        swing_s = min(since_s, truth.time_s - truths[place - 1].time_s)
        _, bend = angular_motion(*_turn(truths[place - 1], truth, 1.0))
    turned_s2 = swing_s * (since_s - 0.5 * swing_s)
    acts = 1.0 if swing_s == since_s else 0.0
    for axis in range(3):
        speed, acceleration = truth.velocity_mps[axis], truth.acceleration_mps2[axis]
        if isnan(acceleration):
            before = truths[place - 1] if place > 0 else truth
            step_s = truth.time_s - before.time_s
            acceleration = (speed - before.velocity_mps[axis]) / step_s if step_s > 0 else 0.0
        moved_m = (speed + 0.5 * acceleration * since_s) * since_s
        vehicle.position_site_m[k, axis] = truth.position_m[axis] + moved_m
        vehicle.velocity_site_mps[k, axis] = speed + acceleration * since_s
        vehicle.acceleration_site_mps2[k, axis] = acceleration
        vehicle.body_rate_radps[k, axis] = truth.body_rate_radps[axis] + bend[axis] * swing_s
        vehicle.angular_acceleration_body_radps2[k, axis] = bend[axis] * acts
    rate = truth.body_rate_radps
    x, y, z = (
        0.5 * (since_s * rate[0] + turned_s2 * bend[0]),
        0.5 * (since_s * rate[1] + turned_s2 * bend[1]),
        0.5 * (since_s * rate[2] + turned_s2 * bend[2]),
    )
    half_turn = sqrt(x * x + y * y + z * z)
    shrunk = sin_over(half_turn)
    w, x, y, z = quaternion_product(
        quaternion_at(truth.site_from_body, 0), (cos(half_turn), shrunk * x, shrunk * y, shrunk * z)
    )
    _set_unit_matrix(w, x, y, z, vehicle.site_from_body[k])


@kernel
def _interpolate(a: Any, b: Any, vehicle: VehicleState, k: int) -> None:
    """Interpolate by Hermite curves, which meet both truths; the quaternion is normalised where it is read."""
    step_s = b.time_s - a.time_s
    s = (vehicle.time_s[k] - a.time_s) / step_s
    for axis in range(3):
        p, q, v, w = a.position_m[axis], b.position_m[axis], a.velocity_mps[axis], b.velocity_mps[axis]
        g, h = a.acceleration_mps2[axis], b.acceleration_mps2[axis]
        bends = not (isnan(g) or isnan(h))
        motion = _quintic(p, q, v, w, g, h, s, step_s) if bends else _cubic(p, q, v, w, s, step_s)
        vehicle.position_site_m[k, axis], vehicle.velocity_site_mps[k, axis] = motion[0], motion[1]
        vehicle.acceleration_site_mps2[k, axis] = motion[2]
    q, slope, bend = _turn(a, b, s)
    rate, acceleration = angular_motion(q, slope, bend)
    store(vehicle.body_rate_radps[k], 0, rate)
    store(vehicle.angular_acceleration_body_radps2[k], 0, acceleration)
    _set_unit_matrix(q[0], q[1], q[2], q[3], vehicle.site_from_body[k])


@kernel
def _turn(a: Any, b: Any, s: float) -> tuple[Quaternion, Quaternion, Quaternion]:
    """Quaternion between two truths at s in 0..1, of any length, with its first and second derivative in time."""
    step_s = b.time_s - a.time_s
    aw, ax, ay, az = q = quaternion_at(a.site_from_body, 0)
    bw, bx, by, bz = p = quaternion_at(b.site_from_body, 0)
    # q and -q are the same attitude: of the two, the nearer one.
    sign = 1.0 if aw * bw + ax * bx + ay * by + az * bz >= 0 else -1.0
    aw_, ax_, ay_, az_ = quaternion_rate(q, vector_at(a.body_rate_radps, 0))
    bw_, bx_, by_, bz_ = quaternion_rate(p, vector_at(b.body_rate_radps, 0))
    w, w_, w__ = _cubic(aw, sign * bw, aw_, sign * bw_, s, step_s)
    x, x_, x__ = _cubic(ax, sign * bx, ax_, sign * bx_, s, step_s)
    y, y_, y__ = _cubic(ay, sign * by, ay_, sign * by_, s, step_s)
    z, z_, z__ = _cubic(az, sign * bz, az_, sign * bz_, s, step_s)
    return (w, x, y, z), (w_, x_, y_, z_), (w__, x__, y__, z__)


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
    u, w, d = p_rate * step_s, q_rate * step_s, q - p
    g, h = 0.5 * p_bend * step_s**2, 0.5 * q_bend * step_s**2
    c3 = 10 * d - 6 * u - 4 * w - 3 * g + h
    c4 = -15 * d + 8 * u + 7 * w + 3 * g - 2 * h
    c5 = 6 * d - 3 * (u + w) - g + h
    value = p + s * (u + s * (g + s * (c3 + s * (c4 + s * c5))))
    rate = u + s * (2 * g + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))
    bend = 2 * g + s * (6 * c3 + s * (12 * c4 + s * 20 * c5))
    return value, rate / step_s, bend / step_s**2


LONGEST_STEP_NS = 10_000_000_000
_KEPT = 64
_CONSISTENT = 3
_MISSING = 256
"""Numbers that may still arrive, so that a late datagram is not counted as lost."""
_REFUSED_FOR_ITS_TIME = (Verdict.OUT_OF_ORDER, Verdict.IMPLAUSIBLE_TIME)
_UNIT_TOLERANCE = 1e-3
_UNKNOWN = (nan, nan, nan)
_STILL = (0.0, 0.0, 0.0)

JUMP_M = 10.0
"""A truth further than this from the extrapolation of the last one is a jump, across which nothing is interpolated."""


class LiveTrajectory(Trajectory):
    """The truth received so far. Between two truths the curve meets position, velocity, attitude and body rate at both
    (and acceleration, where it is known); beyond the newest, acceleration and body rate continue (see
    `live_motion`).

    Args:
        ahead_ns: how far a truth in real time may be ahead, of now or of the newest truth. Three refused truths that
            follow each other within this time, without a jump, are believed instead: the newest was the wrong one.
    """

    duration_s = LONGEST_S

    def __init__(self, ahead_ns: int) -> None:
        self._ahead_ns = ahead_ns
        self.newest: Truth | None = None
        """Newest truth accepted."""
        # The same arrays throughout: a recorded shot goes on reading them.
        self._truths = with_fields(np.empty(_KEPT, dtype=TRUTH))
        self._number = np.zeros(1, dtype=np.int64)
        self.verdicts: Counter[Verdict] = Counter()
        self.jumped = 0
        self.lost = 0
        """Sequence numbers that have not arrived, in order or later."""
        self._last_sequence: int | None = None
        self._missing: dict[int, None] = {}
        self.resumed = 0
        """How often refused truths were believed after all."""
        self._refused: list[Truth] = []

    def accept(self, truth: Truth | None, now_ns: int | None) -> Verdict:
        """Accept a truth, or count the reason for rejecting it.

        Args:
            truth: the decoded datagram; None if it could not be decoded.
            now_ns: scenario time; None in lockstep, and before scenario time has begun.
        """
        if truth is not None:
            self._count_lost(truth.sequence)
        verdict = self._judge(truth, now_ns)
        if verdict in _REFUSED_FOR_ITS_TIME and truth is not None and now_ns is not None:
            verdict = self._judge_again(truth, now_ns, verdict)
        self.verdicts[verdict] += 1
        if verdict is Verdict.ACCEPTED and truth is not None:
            self._refused.clear()
            self.take(truth)
        return verdict

    def take(self, truth: Truth) -> None:
        """Add a truth that was accepted. Nothing is interpolated between it and a newest one that is not older."""
        newest = self.newest
        if newest is not None:
            jumps = _distance_m(newest, truth) > JUMP_M
            self.jumped += jumps
            if jumps or truth.time_ns <= newest.time_ns:
                self._number[0] = 0
        self._append(truth)

    def warm_up(self, truth: Truth) -> None:
        """Run the code that accepts a truth, without any effect on the trajectory."""
        with self.pretending(truth):
            self._judge(truth, None)
            self.take(truth)

    @contextmanager
    def pretending(self, truth: Truth) -> Iterator[None]:
        """Replace all truth by this one, for the duration of the context."""
        newest, truths, number = self.newest, self._truths.copy(), self._number.copy()
        self._number[0] = 0
        self._append(truth)
        try:
            yield
        finally:
            self.newest, self._truths[:], self._number[:] = newest, truths, number

    def state(self, time_s: FloatArray) -> VehicleState:
        """State of the vehicle at scenario times (n,), interpolated or extrapolated from the truth so far.

        Raises:
            ValueError: there is no truth yet.
        """
        if not self._number[0]:
            raise ValueError("there is no truth yet")
        state = VehicleState.unfilled(time_s)
        follow(self._truths, self._number, tuple(state))
        return state

    def _count_lost(self, sequence: int) -> None:
        if sequence in self._missing:
            del self._missing[sequence]
            self.lost -= 1
            return
        last = sequence if self._last_sequence is None else self._last_sequence
        if 0 <= last - sequence < _MISSING:  # repeated or late; further back, the simulator counts anew
            self._last_sequence = last
            return
        self._last_sequence = sequence
        if sequence <= last + 1:
            return
        self.lost += sequence - last - 1
        self._missing.update(dict.fromkeys(range(max(last + 1, sequence - _MISSING), sequence)))
        while len(self._missing) > _MISSING:
            del self._missing[next(iter(self._missing))]

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
        if now_ns is not None:
            latest_ns = now_ns if newest is None else max(now_ns, newest.time_ns)
            if abs(truth.time_ns - now_ns) > LONGEST_STEP_NS or truth.time_ns > latest_ns + self._ahead_ns:
                return Verdict.IMPLAUSIBLE_TIME
        if newest is None:
            possible = 0 <= truth.time_ns <= LONGEST_S * 1e9
            return Verdict.ACCEPTED if possible or now_ns is not None else Verdict.IMPLAUSIBLE_TIME
        if truth.time_ns == newest.time_ns:
            return Verdict.DUPLICATE
        if truth.time_ns < newest.time_ns:
            return Verdict.OUT_OF_ORDER
        if now_ns is None and truth.time_ns - newest.time_ns > LONGEST_STEP_NS:
            return Verdict.IMPLAUSIBLE_TIME
        return Verdict.ACCEPTED

    def _judge_again(self, truth: Truth, now_ns: int, verdict: Verdict) -> Verdict:
        if abs(truth.time_ns - now_ns) > LONGEST_STEP_NS:
            return verdict
        if self._refused:
            before = self._refused[-1]
            if truth.time_ns <= before.time_ns or not _distance_m(before, truth) <= JUMP_M:
                self._refused.clear()
        self._refused.append(truth)
        del self._refused[:-_CONSISTENT]
        if len(self._refused) < _CONSISTENT or truth.time_ns - self._refused[0].time_ns >= self._ahead_ns:
            return verdict
        self.resumed += 1
        return Verdict.ACCEPTED

    def _append(self, truth: Truth) -> None:
        # As bytes: to assign to an array with fields takes as long as all else that is done with a truth.
        memory, size, number = memoryview(self._truths).cast("B"), TRUTH.itemsize, int(self._number[0])
        if number == _KEPT:
            memory[:-size] = memory[size:]
            number -= 1
        _NUMBERS.pack_into(
            memory,
            number * size,
            truth.time_ns * 1e-9,
            *truth.position_site_m,
            *truth.velocity_site_mps,
            *(truth.acceleration_site_mps2 or _UNKNOWN),
            *truth.site_from_body,
            *truth.body_rate_radps,
        )
        self._number[0] = number + 1
        self.newest = truth


def _distance_m(a: Truth, b: Truth) -> float:
    since_s = (b.time_ns - a.time_ns) * 1e-9
    motion = a.position_site_m, a.velocity_site_mps, a.acceleration_site_mps2 or _STILL
    heading_m = (p + (v + 0.5 * g * since_s) * since_s for p, v, g in zip(*motion, strict=True))
    return dist(tuple(heading_m), b.position_site_m)
