"""A trajectory from live truth, interpolated between samples and extrapolated beyond the newest."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from math import dist, isfinite, nan

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import with_fields
from lidar_emu.scenario.schema import LONGEST_S
from lidar_emu.trajectory.live_datagram import Truth, Verdict
from lidar_emu.trajectory.live_motion import TRUTH, follow
from lidar_emu.trajectory.state import Gap, VehicleState

LONGEST_STEP_NS = 10_000_000_000
_KEPT = 64
_CONSISTENT = 3
_REFUSED_FOR_ITS_TIME = (Verdict.OUT_OF_ORDER, Verdict.IMPLAUSIBLE_TIME)
_UNIT_TOLERANCE = 1e-3
_UNKNOWN = (nan, nan, nan)
_STILL = (0.0, 0.0, 0.0)

JUMP_M = 10.0
"""A truth further than this from the extrapolation of the last one is a jump, across which nothing is interpolated."""


class LiveTrajectory:
    """The truth received so far. Between two truths the curve meets position, velocity, attitude and body rate at both
    (and acceleration, where it is known); beyond the newest, acceleration and body rate continue (see
    `live_motion`).

    Args:
        ahead_ns: how far a truth in real time may be ahead, of now or of the newest truth. Three refused truths that
            follow each other within this time, without a jump, are believed instead: the newest was the wrong one.
    """

    duration_s = LONGEST_S
    gaps: tuple[Gap, ...] = ()
    bridged: tuple[Gap, ...] = ()

    def __init__(self, ahead_ns: int) -> None:
        self._ahead_ns = ahead_ns
        self.newest: Truth | None = None
        """Newest truth accepted."""
        self._truths = with_fields(np.empty(_KEPT, dtype=TRUTH))
        self._count = 0
        self.verdicts: Counter[Verdict] = Counter()
        self.jumped = 0
        self.lost = 0
        """Sequence numbers that never arrived, or arrived out of order."""
        self.resumed = 0
        """How often refused truths were believed after all."""
        self._refused: list[Truth] = []

    def accept(self, truth: Truth | None, now_ns: int | None) -> Verdict:
        """Accept a truth, or count the reason for rejecting it.

        Args:
            truth: the decoded datagram; None if it could not be decoded.
            now_ns: scenario time; None in lockstep, and before scenario time has begun.
        """
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
            self.lost += max(0, truth.sequence - newest.sequence - 1)
            jumps = _distance_m(newest, truth) > JUMP_M
            self.jumped += jumps
            if jumps or truth.time_ns <= newest.time_ns:
                self._count = 0
        self._append(truth)

    def warm_up(self, truth: Truth) -> None:
        """Run the code that accepts a truth, without any effect on the trajectory."""
        with self.pretending(truth):
            self._judge(truth, None)
            self.take(truth)

    @contextmanager
    def pretending(self, truth: Truth) -> Iterator[None]:
        """Replace all truth by this one, for the duration of the context."""
        kept = self.newest, self._truths.copy(), self._count
        self._count = 0
        self._append(truth)
        try:
            yield
        finally:
            self.newest, self._truths, self._count = kept

    def state(self, time_s: FloatArray) -> VehicleState:
        """State of the vehicle at scenario times (n,), interpolated or extrapolated from the truth so far.

        Raises:
            ValueError: there is no truth yet.
        """
        if not self._count:
            raise ValueError("there is no truth yet")
        state = VehicleState.unfilled(time_s)
        follow(self._truths[: self._count], tuple(state))
        return state

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
        if now_ns is not None and not self._is_plausible(truth.time_ns, now_ns):
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

    def _is_plausible(self, time_ns: int, now_ns: int) -> bool:
        latest_ns = now_ns if self.newest is None else max(now_ns, self.newest.time_ns)
        return abs(time_ns - now_ns) <= LONGEST_STEP_NS and time_ns <= latest_ns + self._ahead_ns

    def _judge_again(self, truth: Truth, now_ns: int, verdict: Verdict) -> Verdict:
        """The verdict on a truth that is refused for its time, with regard to those refused before it."""
        if abs(truth.time_ns - now_ns) > LONGEST_STEP_NS:
            return verdict
        if self._refused and not self._continues(self._refused[-1], truth):
            self._refused.clear()
        self._refused.append(truth)
        del self._refused[:-_CONSISTENT]
        if len(self._refused) < _CONSISTENT or truth.time_ns - self._refused[0].time_ns >= self._ahead_ns:
            return verdict
        self.resumed += 1
        return Verdict.ACCEPTED

    def _continues(self, before: Truth, truth: Truth) -> bool:
        return truth.time_ns > before.time_ns and _distance_m(before, truth) <= JUMP_M

    def _append(self, truth: Truth) -> None:
        if self._count == _KEPT:
            self._truths[:-1] = self._truths[1:]
            self._count -= 1
        self._truths[self._count] = (
            truth.time_ns * 1e-9,
            truth.position_site_m,
            truth.velocity_site_mps,
            truth.acceleration_site_mps2 or _UNKNOWN,
            truth.site_from_body,
            truth.body_rate_radps,
        )
        self._count += 1
        self.newest = truth


def _distance_m(a: Truth, b: Truth) -> float:
    """Distance between the extrapolation of `a` and the position of `b`."""
    since_s = (b.time_ns - a.time_ns) * 1e-9
    heading_m = (
        p + (v + 0.5 * g * since_s) * since_s
        for p, v, g in zip(
            a.position_site_m, a.velocity_site_mps, a.acceleration_site_mps2 or _STILL, strict=True
        )
    )
    return dist(tuple(heading_m), b.position_site_m)
