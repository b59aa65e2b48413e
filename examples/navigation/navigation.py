"""A navigator: shots in, estimate on. What the beams say goes through parity, gate and filter."""

from typing import NamedTuple

import numpy as np
import snapshot
from beams import Array, DataSheet, Shot
from error_state import HEIGHT, SLOPE, VELOCITY, ErrorState, Predicted
from inertial import Inertial
from trust import Rules, Watch


class Taken(NamedTuple):
    """What became of a shot's ranges, or of its speeds."""

    told: int
    """Beams with a valid value."""
    taken: int
    """Beams that passed the gate."""
    surprise: float
    """Innovations of those squared, over their covariance: chi-square with `taken` degrees of freedom."""
    begun_again: bool = False


class Navigator:
    """A filter, its inertial unit and its distrust."""

    def __init__(
        self, state: ErrorState, inertial: Inertial, time_ns: int, sheet: DataSheet, rules: Rules
    ) -> None:
        self.state, self.time_ns = state, time_ns
        self._inertial, self._sheet = inertial, sheet
        self._ranges, self._speeds = Watch(rules), Watch(rules)

    def take(self, shot: Shot) -> tuple[Taken, Taken] | None:
        """What became of ranges and speeds; None for a shot that is not newer than the estimate, or is yet to come."""
        if not self.time_ns < shot.time_ns <= self._inertial.end_ns:
            return None
        for felt in self._inertial.between(self.time_ns, shot.time_ns):
            self.state.propagate(felt)
        self.time_ns = shot.time_ns
        return self._take_ranges(shot), self._take_speeds(shot)

    def _take_ranges(self, shot: Shot) -> Taken:
        told = np.isfinite(shot.range_m)
        beams, range_m, sigma_m = shot.directions_body[told], shot.range_m[told], shot.sigma_range_m[told]
        plane = snapshot.plane(shot)
        fall_body = self.state.site_from_body.T @ np.append(self.state.slope, -1.0)
        near = snapshot.ranges_about(fall_body / self.state.height_m, beams, range_m, sigma_m)
        parity = least_parity(near, plane.fit if plane else None)
        taken = self._correct(
            self._ranges, parity, range_m, self.state.ranges(beams, self._sheet.acceleration_s2), sigma_m
        )
        if plane is not None and self._ranges.finds_lost(taken.taken, parity):
            return taken._replace(begun_again=self._begin_again_at(plane))
        return taken

    def _take_speeds(self, shot: Shot) -> Taken:
        told = np.isfinite(shot.closing_speed_mps)
        beams, speed_mps = shot.directions_body[told], shot.closing_speed_mps[told]
        sigma_mps = shot.sigma_speed_mps[told]
        alone = snapshot.fit(beams, speed_mps, sigma_mps)
        parity = least_parity(alone)
        taken = self._correct(self._speeds, parity, speed_mps, self.state.speeds(beams), sigma_mps)
        if alone is not None and self._speeds.finds_lost(taken.taken, parity):
            turn = self.state.site_from_body
            error_mps = turn @ alone.value - self.state.velocity_site_mps
            covariance = turn @ alone.covariance @ turn.T * self._speeds.variance_factor
            self.state.begin_again(np.r_[VELOCITY], error_mps, covariance)
            return taken._replace(begun_again=True)
        return taken

    def _correct(
        self, watch: Watch, parity: Array, value: Array, predicted: Predicted, sigma: Array
    ) -> Taken:
        watch.listen(parity)
        nothing = Taken(len(value), 0, 0.0)
        if not watch.is_settled:
            return nothing
        innovation, variance = value - predicted.value, sigma**2 * watch.variance_factor
        spread = predicted.design @ self.state.covariance @ predicted.design.T + np.diag(variance)
        good = watch.inliers(innovation, np.diag(spread))
        if not good.any():
            return nothing
        innovation, spread = innovation[good], spread[np.ix_(good, good)]
        self.state.correct(innovation, predicted.design[good], spread, variance[good])
        return Taken(len(value), int(good.sum()), float(innovation @ np.linalg.solve(spread, innovation)))

    def _begin_again_at(self, plane: snapshot.Plane) -> bool:
        """Height and slopes from a vector a that points to the ground, as long as 1 / distance: h = -1 / a_up."""
        turn = self.state.site_from_body
        east, north, up = turn @ plane.fit.value
        if up >= 0:
            return False
        height_m, slope = -1 / up, np.array([east, north]) / -up
        change = height_m * np.array([[0, 0, height_m], [1, 0, slope[0]], [0, 1, slope[1]]]) @ turn
        error = np.array([height_m - self.state.position_site_m[HEIGHT], *(slope - self.state.slope)])
        covariance = change @ plane.fit.covariance @ change.T * self._ranges.variance_factor
        self.state.begin_again(np.r_[HEIGHT, SLOPE], error, covariance)
        return True


def least_parity(*fits: snapshot.Fit | None) -> Array:
    """Of fits to the same values the least contradiction; nothing where there is none.

    Ranges are not linear in the ground's plane. Expected from the estimate, they contradict each other where that is
    wrong; from themselves, they do not where they are little but noise: the lesser is nearer to the truth.
    """
    parities = [fit.parity for fit in fits if fit is not None]
    return min(parities, key=lambda parity: float(parity @ parity), default=np.empty(0))
