"""A Gaussian beam at a range: its radius, and the curvature of its wavefront."""

from __future__ import annotations

import numpy as np

from lidar_emu.numerics.arrays import FloatArray


def rayleigh_range_m(waist_radius_m: float, wavelength_m: float) -> float:
    """Rayleigh range z, at which the beam's area has doubled."""
    return float(np.pi * waist_radius_m**2 / wavelength_m)


def beam_radius_m(range_m: FloatArray, waist_radius_m: float, wavelength_m: float) -> FloatArray:
    """1/e² intensity radii w of a Gaussian beam at ranges (...)."""
    ratio = range_m / rayleigh_range_m(waist_radius_m, wavelength_m)
    radius_m: FloatArray = waist_radius_m * np.sqrt(1 + ratio * ratio)
    return radius_m


def wavefront_radius_m(range_m: FloatArray, waist_radius_m: float, wavelength_m: float) -> FloatArray:
    """Radii of curvature Rc of a Gaussian beam's wavefront at ranges (...); infinite at the waist."""
    rayleigh_m = rayleigh_range_m(waist_radius_m, wavelength_m)
    with np.errstate(divide="ignore", over="ignore"):
        radius_m: FloatArray = range_m + rayleigh_m * (rayleigh_m / range_m)
    return radius_m
