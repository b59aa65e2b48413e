"""A simulated inertial unit on the true flight: increments of angle and velocity with bias and noise, by seed."""

from collections.abc import Iterator

import numpy as np
from beams import Array
from inertial import GRAVITY_SITE_MPS2, Grade, Increment
from truth import Truth

TICK_NS = 10_000_000


class SimulatedInertial:
    """Increments at 100 Hz, without errors of scale, alignment or coning."""

    def __init__(self, truth: Truth, rng: np.random.Generator, grade: Grade) -> None:
        tick_s = TICK_NS * 1e-9
        ticks = int(truth.duration_s / tick_s) + 200
        flown = truth.states(np.arange(ticks + 1, dtype=np.float64) * tick_s)
        before = flown.site_from_body[:-1]
        turned = np.einsum("kji,kjl->kil", before, flown.site_from_body[1:])
        increment_site = np.diff(flown.velocity_site_mps, axis=0) - GRAVITY_SITE_MPS2 * tick_s
        angle_rad = rotation_vectors(turned)
        velocity_mps = np.einsum("kji,kj->ki", before, increment_site)
        angle_rad += rng.normal(0, grade.gyroscope_bias_radps, 3) * tick_s
        angle_rad += rng.normal(0, grade.gyroscope_noise * tick_s**0.5, angle_rad.shape)
        velocity_mps += rng.normal(0, grade.accelerometer_bias_mps2, 3) * tick_s
        velocity_mps += rng.normal(0, grade.accelerometer_noise * tick_s**0.5, velocity_mps.shape)
        self._angle_rad, self._velocity_mps = angle_rad, velocity_mps
        self.end_ns = ticks * TICK_NS

    def between(self, start_ns: int, end_ns: int) -> Iterator[Increment]:
        """Increments over an interval; a tick that is divided contributes in proportion."""
        while start_ns < end_ns:
            tick = start_ns // TICK_NS
            until_ns = min(end_ns, (tick + 1) * TICK_NS)
            share = (until_ns - start_ns) / TICK_NS
            yield Increment(
                (until_ns - start_ns) * 1e-9, share * self._angle_rad[tick], share * self._velocity_mps[tick]
            )
            start_ns = until_ns


def rotation_vectors(rotations: Array) -> Array:
    """Rotation vectors (k, 3) of rotations (k, 3, 3) by at most half a turn."""
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
    vectors: Array = twice_sine_axis / (2 * np.sinc(angle / np.pi))[:, None]
    return vectors
