"""A navigator: shots in, estimate out. Measurements pass parity, gate and filter."""

from typing import NamedTuple

import numpy as np
import snapshot
from beams import Array, DataSheet, Shot
from error_state import HEIGHT, SLOPE, VELOCITY, ErrorState, Predicted
from inertial import Inertial
from trust import NoiseMonitor, Rules


class UpdateResult(NamedTuple):
    """Result of the update by a shot's ranges, or by its speeds."""

    valid: int
    """Beams with a valid value."""
    accepted: int
    """Beams that passed the gate."""
    nis: float
    """Normalised innovation squared: chi-square with `accepted` degrees of freedom."""
    reinitialised: bool = False
    used: tuple[bool, ...] = ()
    """Whether each valid value passed the gate; empty while nothing is judged."""


class Navigator:
    """A filter with its inertial unit and its monitors."""

    def __init__(
        self, state: ErrorState, inertial: Inertial, time_ns: int, sheet: DataSheet, rules: Rules
    ) -> None:
        self.state, self.time_ns = state, time_ns
        self._inertial, self._sheet = inertial, sheet
        self._ranges, self._speeds = NoiseMonitor(rules), NoiseMonitor(rules)

    def take(self, shot: Shot) -> tuple[UpdateResult, UpdateResult] | None:
        """Update by a shot: results of ranges and speeds; None for a shot that is not newer than the estimate, or is
        in the future."""
        if not self.time_ns < shot.time_ns <= self._inertial.end_ns:
            return None
        for increment in self._inertial.between(self.time_ns, shot.time_ns):
            self.state.propagate(increment)
        self.time_ns = shot.time_ns
        return self._take_ranges(shot), self._take_speeds(shot)

    def _take_ranges(self, shot: Shot) -> UpdateResult:
        valid = np.isfinite(shot.range_m)
        beams, range_m, sigma_m = shot.directions_body[valid], shot.range_m[valid], shot.sigma_range_m[valid]
        plane = snapshot.plane(shot)
        fall_body = self.state.site_from_body.T @ np.append(self.state.slope, -1.0)
        near = snapshot.ranges_about(fall_body / self.state.height_m, beams, range_m, sigma_m)
        parity = least_parity(near, plane.fit if plane else None)
        accepted = self._correct(
            self._ranges, parity, range_m, self.state.ranges(beams, self._sheet.acceleration_s2), sigma_m
        )
        if plane is not None and self._ranges.detects_divergence(accepted.accepted, parity):
            return accepted._replace(reinitialised=self._reinitialise_from(plane))
        return accepted

    def _take_speeds(self, shot: Shot) -> UpdateResult:
        valid = np.isfinite(shot.closing_speed_mps)
        beams, speed_mps = shot.directions_body[valid], shot.closing_speed_mps[valid]
        sigma_mps = shot.sigma_speed_mps[valid]
        single_shot = snapshot.fit(beams, speed_mps, sigma_mps)
        parity = least_parity(single_shot)
        accepted = self._correct(self._speeds, parity, speed_mps, self.state.speeds(beams), sigma_mps)
        if single_shot is not None and self._speeds.detects_divergence(accepted.accepted, parity):
            turn = self.state.site_from_body
            error_mps = turn @ single_shot.value - self.state.velocity_site_mps
            covariance = turn @ single_shot.covariance @ turn.T * self._speeds.variance_factor
            self.state.reinitialise(np.r_[VELOCITY], error_mps, covariance)
            return accepted._replace(reinitialised=True)
        return accepted

    def _correct(
        self, monitor: NoiseMonitor, parity: Array, value: Array, predicted: Predicted, sigma: Array
    ) -> UpdateResult:
        monitor.add(parity)
        nothing = UpdateResult(len(value), 0, 0.0)
        if not monitor.is_ready:
            return nothing
        innovation, variance = value - predicted.value, sigma**2 * monitor.variance_factor
        innovation_covariance = predicted.design @ self.state.covariance @ predicted.design.T + np.diag(
            variance
        )
        good = monitor.inliers(innovation, np.diag(innovation_covariance))
        used = tuple(good.tolist())
        if not good.any():
            return nothing._replace(used=used)
        innovation, innovation_covariance = innovation[good], innovation_covariance[np.ix_(good, good)]
        self.state.correct(innovation, predicted.design[good], innovation_covariance, variance[good])
        return UpdateResult(
            len(value),
            int(good.sum()),
            float(innovation @ np.linalg.solve(innovation_covariance, innovation)),
            used=used,
        )

    def _reinitialise_from(self, plane: snapshot.Plane) -> bool:
        """Reinitialise height and slopes from the vector a toward the ground of length 1 / distance: height is -1 /
        a_up."""
        turn = self.state.site_from_body
        east, north, up = turn @ plane.fit.value
        if up >= 0:
            return False
        height_m, slope = -1 / up, np.array([east, north]) / -up
        change = height_m * np.array([[0, 0, height_m], [1, 0, slope[0]], [0, 1, slope[1]]]) @ turn
        error = np.array([height_m - self.state.position_site_m[HEIGHT], *(slope - self.state.slope)])
        covariance = change @ plane.fit.covariance @ change.T * self._ranges.variance_factor
        self.state.reinitialise(np.r_[HEIGHT, SLOPE], error, covariance)
        return True


def least_parity(*fits: snapshot.Fit | None) -> Array:
    """Smallest parity among fits to the same values; empty if there is none.

    Ranges are not linear in the plane of the ground. The parity about the estimate's plane contains the error of the
    estimate, and the parity about the ranges' own plane is little but noise where the estimate is good: the smaller one
    is nearer to the truth.
    """
    parities = [fit.parity for fit in fits if fit is not None]
    return min(parities, key=lambda parity: float(parity @ parity), default=np.empty(0))
