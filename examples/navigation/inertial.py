"""An inertial unit on the true flight: increments of angle and velocity with bias and noise, the same for a seed."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from beams import Array
from truth import GRAVITY_SITE_MPS2, Truth

TICK_NS = 10_000_000


@dataclass(frozen=True)
class Grade:
    """How good it is."""

    accelerometer_bias_mps2: float = 3e-3
    """Standard deviation of a bias that stays, as for the gyroscope."""
    accelerometer_noise: float = 5e-4
    """Of velocity after one second: m/s per square root of s."""
    gyroscope_bias_radps: float = 5e-6
    gyroscope_noise: float = 2e-5
    """Of angle after one second: rad per square root of s."""


TACTICAL = Grade()


class Increment(NamedTuple):
    """What was felt in an interval."""

    duration_s: float
    angle_body_rad: Array
    """Rotation vector."""
    velocity_body_mps: Array
    """Of the forces other than gravity, along the body's axes at the interval's start."""


class Inertial:
    """Increments at 100 Hz, without errors of scale, alignment or coning: those are not what is shown here."""

    def __init__(self, truth: Truth, rng: np.random.Generator, grade: Grade) -> None:
        tick_s = TICK_NS * 1e-9
        ticks = int(truth.duration_s / tick_s) + 200
        flown = truth.states(np.arange(ticks + 1) * tick_s)
        before = flown.site_from_body[:-1]
        turned = np.einsum("kji,kjl->kil", before, flown.site_from_body[1:])
        felt_site = np.diff(flown.velocity_site_mps, axis=0) - GRAVITY_SITE_MPS2 * tick_s
        angle_rad = rotation_vectors(turned)
        velocity_mps = np.einsum("kji,kj->ki", before, felt_site)
        angle_rad += rng.normal(0, grade.gyroscope_bias_radps, 3) * tick_s
        angle_rad += rng.normal(0, grade.gyroscope_noise * tick_s**0.5, angle_rad.shape)
        velocity_mps += rng.normal(0, grade.accelerometer_bias_mps2, 3) * tick_s
        velocity_mps += rng.normal(0, grade.accelerometer_noise * tick_s**0.5, velocity_mps.shape)
        self._angle_rad, self._velocity_mps = angle_rad, velocity_mps
        self.end_ns = ticks * TICK_NS
        """Up to which it knows what is felt."""

    def between(self, start_ns: int, end_ns: int) -> Iterator[Increment]:
        """What was felt from one instant to another, not after `end_ns`; a tick that is cut is cut in proportion."""
        while start_ns < end_ns:
            tick = start_ns // TICK_NS
            until_ns = min(end_ns, (tick + 1) * TICK_NS)
            share = (until_ns - start_ns) / TICK_NS
            yield Increment(
                (until_ns - start_ns) * 1e-9, share * self._angle_rad[tick], share * self._velocity_mps[tick]
            )
            start_ns = until_ns


def rotation_vectors(rotations: Array) -> Array:
    """The vectors (k, 3) of rotations (k, 3, 3) that are small: of half a turn at most."""
    twice_sine_axis = np.stack(
        [
            rotations[:, 2, 1] - rotations[:, 1, 2],
            rotations[:, 0, 2] - rotations[:, 2, 0],
            rotations[:, 1, 0] - rotations[:, 0, 1],
        ],
        axis=-1,
    )
    sine = np.linalg.norm(twice_sine_axis, axis=-1) / 2
    angle = np.arctan2(sine, (np.trace(rotations, axis1=1, axis2=2) - 1) / 2)
    return twice_sine_axis / (2 * np.sinc(angle / np.pi))[:, None]
