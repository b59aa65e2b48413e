"""An error-state Kalman filter: inertial increments propagate the estimate, beams correct it.

The states are, in the order of the covariance: position (east, north, height above the ground), velocity, attitude,
biases of accelerometers and gyroscopes, slope of the ground to the east and to the north. The attitude error psi is a
small rotation in the site frame, true = exp([psi]x) estimate. East and north are dead reckoning: no beam observes them.
The ground is modelled as a plane that changes as the vehicle flies over it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from beams import Array
from inertial import GRAVITY_SITE_MPS2, Grade, Increment
from numpy.typing import NDArray

POSITION, VELOCITY, ATTITUDE = slice(0, 3), slice(3, 6), slice(6, 9)
ACCELEROMETER, GYROSCOPE, SLOPE = slice(9, 12), slice(12, 15), slice(15, 17)
HEIGHT = 2
ERRORS = 17

LEAST_HEIGHT_M = 0.5


@dataclass(frozen=True)
class Ground:
    """Statistics of the ground. Correlation with earlier ground decays over a path as long as the height, after which
    the beams fall elsewhere."""

    slope_sigma: float = 0.05
    """Standard deviation of the slope of the plane below the beams: three degrees."""
    relief_sigma: float = 0.002
    """Standard deviation of that plane's height, per metre of height above it."""


MARE = Ground()


class Predicted(NamedTuple):
    """Predicted measurements."""

    value: Array
    """(beams,) Predicted values."""
    design: Array
    """(beams, 17) Derivatives with respect to the errors."""


class ErrorState:
    """Estimate and covariance."""

    def __init__(
        self,
        position_site_m: Array,
        velocity_site_mps: Array,
        site_from_body: Array,
        sigmas: Array,
        grade: Grade,
        ground: Ground,
    ) -> None:
        """Initialise the filter.

        Args:
            position_site_m: (3,) east, north and height above the ground.
            velocity_site_mps: (3,) velocity.
            site_from_body: (3, 3) attitude.
            sigmas: (9,) standard deviations of position, velocity and attitude.
            grade: errors of the inertial unit.
            ground: statistics of the ground.
        """
        self.position_site_m, self.velocity_site_mps = position_site_m.copy(), velocity_site_mps.copy()
        self.site_from_body = site_from_body.copy()
        self.accelerometer_bias_mps2, self.gyroscope_bias_radps = np.zeros(3), np.zeros(3)
        self.slope = np.zeros(2)
        self.acceleration_site_mps2 = np.zeros(3)
        biases = [grade.accelerometer_bias_mps2] * 3 + [grade.gyroscope_bias_radps] * 3
        self.covariance = np.diag(np.concatenate([sigmas, biases, [ground.slope_sigma] * 2]) ** 2)
        self._ground = ground
        self._velocity_walk, self._attitude_walk = grade.accelerometer_noise**2, grade.gyroscope_noise**2

    @property
    def height_m(self) -> float:
        """Estimated height above the ground, at least `LEAST_HEIGHT_M`: a diverged estimate may be below it."""
        return max(float(self.position_site_m[HEIGHT]), LEAST_HEIGHT_M)

    def propagate(self, increment: Increment) -> None:
        """Propagate estimate and covariance over an increment."""
        step_s = increment.duration_s
        force = self.site_from_body @ (increment.velocity_body_mps / step_s - self.accelerometer_bias_mps2)
        self.acceleration_site_mps2 = force + GRAVITY_SITE_MPS2
        moved_m = (self.velocity_site_mps + self.acceleration_site_mps2 * step_s / 2) * step_s
        self._propagate_covariance(force, moved_m, step_s)
        moved_m[HEIGHT] -= self.slope @ moved_m[:2]
        self.position_site_m += moved_m
        self.velocity_site_mps += self.acceleration_site_mps2 * step_s
        self.site_from_body = self.site_from_body @ rotation(
            increment.angle_body_rad - self.gyroscope_bias_radps * step_s
        )

    def _propagate_covariance(self, force: Array, moved_m: Array, step_s: float) -> None:
        """Propagate the covariance, and decorrelate the ground."""
        change = np.eye(ERRORS)
        change[POSITION, VELOCITY] = np.eye(3) * step_s
        change[HEIGHT, 3:5] = -self.slope * step_s
        change[HEIGHT, SLOPE] = -moved_m[:2]
        change[VELOCITY, ATTITUDE] = -skew(force) * step_s
        change[VELOCITY, ACCELEROMETER] = -self.site_from_body * step_s
        change[ATTITUDE, GYROSCOPE] = -self.site_from_body * step_s
        correlation = np.exp(-np.linalg.norm(moved_m) / self.height_m)
        change[SLOPE, SLOPE] *= correlation
        self.slope *= correlation
        noise = np.zeros(ERRORS)
        noise[VELOCITY], noise[ATTITUDE] = self._velocity_walk * step_s, self._attitude_walk * step_s
        noise[SLOPE] = self._ground.slope_sigma**2 * (1 - correlation**2)
        noise[HEIGHT] = (self._ground.relief_sigma * self.height_m) ** 2 * (1 - correlation**2)
        self.covariance = change @ self.covariance @ change.T + np.diag(noise)

    def ranges(self, beams_body: Array, coupling_s2: float) -> Predicted:
        """Predicted ranges to the plane below; NaN for beams that do not hit it.

        Args:
            beams_body: (n, 3) unit vectors of the beams.
            coupling_s2: bias of a range in metres per m/s^2 of closing acceleration.
        """
        beams_site = beams_body @ self.site_from_body.T
        fall = np.append(self.slope, -1.0)
        steepness = beams_site @ fall
        steepness = np.where(steepness > 0.02, steepness, np.nan)
        range_m = self.height_m / steepness
        design = np.zeros((len(beams_body), ERRORS))
        design[:, HEIGHT] = 1 / steepness
        share = -(range_m / steepness)[:, None]
        design[:, SLOPE] = share * beams_site[:, :2]
        design[:, ATTITUDE] = share * np.cross(beams_site, fall)
        return Predicted(range_m + coupling_s2 * (beams_site @ self.acceleration_site_mps2), design)

    def speeds(self, beams_body: Array) -> Predicted:
        """Predicted closing speeds along beams (n, 3)."""
        beams_site = beams_body @ self.site_from_body.T
        design = np.zeros((len(beams_body), ERRORS))
        design[:, VELOCITY] = beams_site
        design[:, ATTITUDE] = np.cross(beams_site, self.velocity_site_mps)
        return Predicted(beams_site @ self.velocity_site_mps, design)

    def correct(
        self, innovation: Array, design: Array, innovation_covariance: Array, variances: Array
    ) -> None:
        """Correct the estimate by n measurements.

        Args:
            innovation: (n,) measured minus predicted values.
            design: (n, 17) design matrix of the prediction.
            innovation_covariance: (n, n) covariance of the innovations.
            variances: (n,) variances of the measurements.
        """
        gain = np.linalg.solve(innovation_covariance, design @ self.covariance).T
        left = np.eye(ERRORS) - gain @ design
        self.covariance = (
            left @ self.covariance @ left.T + (gain * variances) @ gain.T
        )  # Joseph: stays positive
        self._move(gain @ innovation)

    def reinitialise(self, rows: NDArray[np.intp], error: Array, covariance: Array) -> None:
        """Correct some states, remove their correlation with the others, and set their covariance."""
        whole = np.zeros(ERRORS)
        whole[rows] = error
        self._move(whole)
        self.covariance[rows, :] = 0.0
        self.covariance[:, rows] = 0.0
        self.covariance[np.ix_(rows, rows)] = covariance

    def _move(self, error: Array) -> None:
        self.position_site_m += error[POSITION]
        self.velocity_site_mps += error[VELOCITY]
        self.site_from_body = rotation(error[ATTITUDE]) @ self.site_from_body
        self.accelerometer_bias_mps2 += error[ACCELEROMETER]
        self.gyroscope_bias_radps += error[GYROSCOPE]
        self.slope += error[SLOPE]


def skew(vector: Array) -> Array:
    """Matrix of the cross product from the left."""
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def rotation(vector: Array) -> Array:
    """exp([vector]x), by Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    turn = skew(vector)
    return np.eye(3) + np.sinc(angle / np.pi) * turn + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (turn @ turn)
