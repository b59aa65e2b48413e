"""Link budget: how much light of a surface returns in the receiver's own spatial mode."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_emu.scenario.instrument import Instrument
from lidar_emu.scenario.site import Atmosphere, Surface


def coherent_power_w(
    instrument: Instrument,
    surface: Surface,
    atmosphere: Atmosphere | None,
    range_m: ArrayLike,
    cos_incidence: ArrayLike,
) -> NDArray[np.float64]:
    """Power of the echo in the mode of the local oscillator, with the whole beam on such a surface.

    A monostatic transceiver with matched Gaussian modes: P = P_t η (ρ/π) f(θ) T² λ² / (π w(R)²), with w(R)² =
    w0² [1 + (λR / π w0²)²], valid near and far; far away it is the effective aperture π w0² / R² of the
    antenna theorem. η is the optics' efficiency times the depolarisation. The heterodyne efficiency is *not*
    in it: the receiver applies it when it turns power into photons detected (`build_receiver`). The surface's
    f(θ) = L + (1 - L) cos θ runs from Lambert (L = 0) to the Moon's lack of limb darkening at zero phase
    angle (L = 1); T² = exp(-2 α R).

    Args:
        instrument: laser power, wavelength and optics.
        surface: albedo ρ and L.
        atmosphere: extinction α; None is vacuum.
        range_m: any shape, NaN where nothing is met.
        cos_incidence: same shape; cosine of the angle between the ray back to the sensor and the normal.

    Returns:
        Watts in the broadcast shape: NaN where an argument is NaN, 0 for a surface seen from behind.
    """
    wavelength_m, optics = instrument.waveform.wavelength_m, instrument.optics
    range_m, cos_incidence = np.asarray(range_m, dtype=float), np.asarray(cos_incidence, dtype=float)
    rayleigh_range_m = np.pi * optics.waist_radius_m**2 / wavelength_m
    spread = 1.0 + np.square(range_m / rayleigh_range_m)
    coupling = wavelength_m**2 / (np.pi * optics.waist_radius_m**2 * spread)
    radiance = surface.reflectance / np.pi * _limb(surface.lommel_seeliger_share, cos_incidence)
    efficiency = optics.optical_efficiency * optics.depolarisation
    power_w = optics.laser_power_w * efficiency * radiance * coupling
    if atmosphere is None:
        return np.asarray(power_w)
    return np.asarray(power_w * np.exp(-2.0 * atmosphere.extinction_per_m * range_m))


def _limb(lommel_seeliger_share: float, cos_incidence: NDArray[np.float64]) -> NDArray[np.float64]:
    factor = lommel_seeliger_share + (1.0 - lommel_seeliger_share) * cos_incidence
    return np.where(cos_incidence <= 0.0, 0.0, factor)
