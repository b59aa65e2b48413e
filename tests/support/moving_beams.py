"""Beams in closed-form motion over a level plane, and scatterers on it."""

from __future__ import annotations

import numpy as np

from lidar_emu.reference.record_light import BeamPoses, GaussianMode, PosesAt, Scatterers
from lidar_emu.scenario.instrument import Instrument

DOWN = np.array([0.0, 0.0, -1.0])


def gliding(velocity_mps: object, acceleration_mps2: float = 0.0) -> PosesAt:
    """Straight down from the origin, with a velocity and an acceleration downward."""

    def poses_at(time_s: np.ndarray) -> BeamPoses:
        down = np.tile(DOWN, (len(time_s), 1))
        sensor_m = time_s[:, None] * np.asarray(velocity_mps, dtype=float)
        return BeamPoses(sensor_m + 0.5 * acceleration_mps2 * time_s[:, None] ** 2 * DOWN, down, down)

    return poses_at


def turning(rate_radps: float, arm_m: float = 0.0, angular_radps2: float = 0.0) -> PosesAt:
    """About the y axis through a point `arm_m` beside the aperture; straight down at time 0."""

    def poses_at(time_s: np.ndarray) -> BeamPoses:
        angle = rate_radps * time_s + 0.5 * angular_radps2 * time_s**2
        zero = np.zeros_like(angle)
        axis = np.stack([np.sin(angle), zero, -np.cos(angle)], axis=-1)
        sensor_m = arm_m * np.stack([np.cos(angle) - 1.0, zero, np.sin(angle)], axis=-1)
        return BeamPoses(sensor_m, axis, axis)

    return poses_at


def even_plane(instrument: Instrument, range_m: float, slope: float = 0.0, cells: int = 61) -> Scatterers:
    """Equal scatterers on a square grid, whose sums are the integrals over the plane."""
    place_m = 2.2 * GaussianMode.of(instrument).radius_m(range_m) * np.linspace(-1.0, 1.0, cells)
    east_m, north_m = (values.ravel() for values in np.meshgrid(place_m, place_m))
    position_m = np.stack([east_m, north_m, slope * east_m - range_m], axis=-1)
    return Scatterers(position_m, np.zeros_like(position_m), np.ones(len(position_m), dtype=complex))


def speckled(scatterers: Scatterers, seed: int) -> Scatterers:
    """The same with circular complex Gaussian amplitudes."""
    drawn = np.random.default_rng(seed).standard_normal((len(scatterers.amplitude), 2))
    return scatterers._replace(amplitude=scatterers.amplitude * (drawn @ np.array([1.0, 1j])))
