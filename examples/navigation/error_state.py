"""An error-state Kalman filter: inertial increments carry the estimate, beams correct it.

What is estimated, and in which order its errors stand in the covariance: position (east, north, height above the
ground), velocity, attitude, biases of accelerometers and gyroscopes, slope of the ground to the east and to the north.
The error psi of the attitude is a small rotation in the site frame, true = exp([psi]x) estimate. East and north are
dead reckoning: no beam tells them. The ground below is a plane that changes as it is flown over.
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
    """What is expected of the ground. What was seen of it is forgotten over a path as long as the height: by then the
    beams fall elsewhere."""

    slope_sigma: float = 0.05
    """Of the slope of the plane that the beams see: three degrees."""
    relief_sigma: float = 0.002
    """Of that plane's height, for each metre of height above it."""


MARE = Ground()


class Predicted(NamedTuple):
    """What beams are expected to say."""

    value: Array
    """(beams,)"""
    design: Array
    """(beams, 17) How it changes with the errors."""


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
        """Begin.

        Args:
            position_site_m: (3,) east, north and height above the ground.
            velocity_site_mps: (3,)
            site_from_body: (3, 3)
            sigmas: (9,) of position, velocity and attitude.
            grade: of the inertial unit.
            ground: what is below.
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
        """Above the ground; a filter that has lost it may think itself below."""
        return max(float(self.position_site_m[HEIGHT]), LEAST_HEIGHT_M)

    def propagate(self, felt: Increment) -> None:
        """Carry estimate and covariance over an increment."""
        step_s = felt.duration_s
        force = self.site_from_body @ (felt.velocity_body_mps / step_s - self.accelerometer_bias_mps2)
        self.acceleration_site_mps2 = force + GRAVITY_SITE_MPS2
        moved_m = (self.velocity_site_mps + self.acceleration_site_mps2 * step_s / 2) * step_s
        self._spread(force, moved_m, step_s)
        moved_m[HEIGHT] -= self.slope @ moved_m[:2]
        self.position_site_m += moved_m
        self.velocity_site_mps += self.acceleration_site_mps2 * step_s
        self.site_from_body = self.site_from_body @ rotation(
            felt.angle_body_rad - self.gyroscope_bias_radps * step_s
        )

    def _spread(self, force: Array, moved_m: Array, step_s: float) -> None:
        """Carry the covariance, and forget the ground."""
        change = np.eye(ERRORS)
        change[POSITION, VELOCITY] = np.eye(3) * step_s
        change[HEIGHT, 3:5] = -self.slope * step_s
        change[HEIGHT, SLOPE] = -moved_m[:2]
        change[VELOCITY, ATTITUDE] = -skew(force) * step_s
        change[VELOCITY, ACCELEROMETER] = -self.site_from_body * step_s
        change[ATTITUDE, GYROSCOPE] = -self.site_from_body * step_s
        forgets = np.exp(-np.linalg.norm(moved_m) / self.height_m)
        change[SLOPE, SLOPE] *= forgets
        self.slope *= forgets
        noise = np.zeros(ERRORS)
        noise[VELOCITY], noise[ATTITUDE] = self._velocity_walk * step_s, self._attitude_walk * step_s
        noise[SLOPE] = self._ground.slope_sigma**2 * (1 - forgets**2)
        noise[HEIGHT] = (self._ground.relief_sigma * self.height_m) ** 2 * (1 - forgets**2)
        self.covariance = change @ self.covariance @ change.T + np.diag(noise)

    def ranges(self, beams_body: Array, coupling_s2: float) -> Predicted:
        """Ranges to the plane below; NaN for beams that would not meet it.

        Args:
            beams_body: (n, 3)
            coupling_s2: metres that a range reads too long for each m/s^2 of closing acceleration.
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
        """Closing speeds along beams (n, 3)."""
        beams_site = beams_body @ self.site_from_body.T
        design = np.zeros((len(beams_body), ERRORS))
        design[:, VELOCITY] = beams_site
        design[:, ATTITUDE] = np.cross(beams_site, self.velocity_site_mps)
        return Predicted(beams_site @ self.velocity_site_mps, design)

    def correct(self, innovation: Array, design: Array, spread: Array, variances: Array) -> None:
        """Take in what n beams said.

        Args:
            innovation: (n,) what was said less what was predicted.
            design: (n, 17) of the prediction.
            spread: (n, n) covariance of the innovations.
            variances: (n,) of the beams themselves.
        """
        gain = np.linalg.solve(spread, design @ self.covariance).T
        left = np.eye(ERRORS) - gain @ design
        self.covariance = (
            left @ self.covariance @ left.T + (gain * variances) @ gain.T
        )  # Joseph: stays positive
        self._move(gain @ innovation)

    def begin_again(self, rows: NDArray[np.intp], error: Array, covariance: Array) -> None:
        """Put some errors right, forget what they had to do with the others, and give them a covariance."""
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
    """The matrix of the vector product from the left."""
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def rotation(vector: Array) -> Array:
    """exp([vector]x), by Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    turn = skew(vector)
    return np.eye(3) + np.sinc(angle / np.pi) * turn + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (turn @ turn)
