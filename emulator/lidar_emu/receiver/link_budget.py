"""Link budget: power from a surface, the atmosphere and the sun in the receiver's own spatial mode."""

from __future__ import annotations

from functools import partial
from math import exp, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import interpreted, kernel
from lidar_emu.numerics.vectors import Vector
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument, Receiver
from lidar_emu.scenario.site import Atmosphere, Site, Surface

PLANCK_J_S = 6.626_070_15e-34
BOLTZMANN_J_PER_K = 1.380_649e-23
ELEMENTARY_CHARGE_C = 1.602_176_634e-19


class EchoLaw(NamedTuple):
    """Constants of the echo's power as a function of range and incidence."""

    emitted_w: float
    """Laser power less the losses of optics and depolarisation."""
    coupling: float
    """λ²/(π w0²): power in the local oscillator's mode per W/sr that the footprint scatters back, just ahead of the
    aperture."""
    lommel_seeliger_share: float
    parting_per_m: float
    """Separation of the two modes by their alignment, in radii at the waist, per metre of range."""
    lag_s_per_m2: float
    """Separation of the two modes by the beam's rotation while the light travels, 2/(c w0): in radii at the waist, per
    rad/s and square metre of range. 0 leaves it out."""
    extinction_per_m: float
    wind_mps: Vector
    """Velocity of the air in the site frame."""
    waist_m: float
    rayleigh_m: float


def echo_law(instrument: Instrument, surface: Surface, atmosphere: Atmosphere | None) -> EchoLaw:
    """Constants of `coherent_power_w`, for surfaces of any albedo; its arguments are explained there."""
    wavelength_m, optics = instrument.waveform.wavelength_m, instrument.optics
    efficiency = optics.optical_efficiency * optics.depolarisation
    return EchoLaw(
        emitted_w=float(optics.laser_power_w * efficiency),
        coupling=float(wavelength_m**2 / (np.pi * optics.waist_radius_m**2)),
        lommel_seeliger_share=float(surface.lommel_seeliger_share),
        parting_per_m=float(optics.alignment_error_rad / optics.waist_radius_m),
        lag_s_per_m2=2.0 / (SPEED_OF_LIGHT_MPS * float(optics.waist_radius_m)),
        extinction_per_m=0.0 if atmosphere is None else float(atmosphere.extinction_per_m),
        wind_mps=(0.0, 0.0, 0.0) if atmosphere is None else atmosphere.wind_mps,
        waist_m=float(optics.waist_radius_m),
        rayleigh_m=float(np.pi * optics.waist_radius_m**2 / wavelength_m),
    )


@kernel
def echo_power_w(
    law: EchoLaw, reflectance: float, range_m: float, cos_incidence: float, turning_radps: float
) -> float:
    """Power of one echo; see `coherent_power_w`."""
    farness, parting = range_m / law.rayleigh_m, law.parting_per_m * range_m
    lag = law.lag_s_per_m2 * turning_radps * range_m * range_m
    spread = 1.0 + farness * farness
    apart = parting * parting + lag * lag
    dimmed = exp(-apart / spread - 2.0 * law.extinction_per_m * range_m) / spread
    limb = law.lommel_seeliger_share + (1.0 - law.lommel_seeliger_share) * cos_incidence
    facing_w = law.emitted_w * reflectance / pi * law.coupling
    return facing_w * (0.0 if cos_incidence <= 0.0 else limb) * dimmed


def coherent_power_w(
    instrument: Instrument,
    surface: Surface,
    atmosphere: Atmosphere | None,
    range_m: ArrayLike,
    cos_incidence: ArrayLike,
    turning_radps: ArrayLike = 0.0,
) -> NDArray[np.float64]:
    """Power of the echo in the mode of the local oscillator, with the whole beam on one surface.

    A monostatic transceiver with matched Gaussian modes receives P = P_t η (ρ/π) f(θ) T² λ² / (π w(R)²), with w(R)² =
    w0² [1 + (λR / π w0²)²], valid in the near and the far field; in the far field this is the effective aperture π w0²
    / R² of the antenna theorem. η is the product of the optics' efficiency, the depolarisation and exp(-(d/w)²), the
    overlap of two Gaussian modes whose centres are d apart on the ground: d² = (Rγ)² + (Ru' 2R/c)² with the alignment
    error γ, and the rate u' at which the beam turns while the light travels (docs/physics.md). The heterodyne
    efficiency is *not* included: the receiver applies it when it converts power to detected photons (`build_receiver`).
    The surface's f(θ) = L + (1 - L) cos θ runs from Lambert (L = 0) to the Moon's lack of limb darkening at zero phase
    angle (L = 1); T² = exp(-2 α R).

    Args:
        instrument: laser power, wavelength and optics.
        surface: albedo ρ and L.
        atmosphere: extinction α; None is vacuum.
        range_m: any shape, NaN where nothing is hit.
        cos_incidence: same shape; cosine of the angle between the ray back to the sensor and the normal.
        turning_radps: same shape; rate of the beam's direction.

    Returns:
        Watts in the broadcast shape: NaN where an argument is NaN, 0 for a surface seen from behind.
    """
    law = partial(interpreted(echo_power_w), echo_law(instrument, surface, atmosphere), surface.reflectance)
    return np.asarray(np.vectorize(law, otypes=[float])(range_m, cos_incidence, turning_radps))


def backscatter_w(instrument: Instrument, atmosphere: Atmosphere | None, range_m: FloatArray) -> FloatArray:
    """Power that a thin layer returns in the mode of the local oscillator, per backscatter of 1/sr, in range_m's shape.

    The value is P_t η λ²/(π w(R)²) exp(-2αR): as for a surface, with the backscatter coefficient times the thickness
    instead of its radiance, and without depolarisation, since the particles are assumed to be spherical.
    """
    optics, wavelength_m = instrument.optics, instrument.waveform.wavelength_m
    area_m2 = np.pi * optics.waist_radius_m**2
    spread = 1.0 + np.square(range_m * wavelength_m / area_m2)
    extinction_per_m = 0.0 if atmosphere is None else atmosphere.extinction_per_m
    emitted_w = optics.laser_power_w * optics.optical_efficiency
    dimmed = np.exp(-2.0 * extinction_per_m * range_m) / spread
    return np.asarray(emitted_w * wavelength_m**2 / area_m2 * dimmed)


def haze_w_per_m(instrument: Instrument, atmosphere: Atmosphere) -> float:
    """Power that each metre of air just before the sensor returns in the mode of the local oscillator: P_t η β
    λ²/(π w0²), see `backscatter_w`."""
    return float(backscatter_w(instrument, None, np.zeros(()))) * atmosphere.backscatter_per_m_sr


def sunlight_over_shot(instrument: Instrument, site: Site) -> float:
    """Noise of the sunlit ground over the shot noise of the local oscillator.

    The ground's spectral radiance is ρ E/π, or ρ E λ²/(π c) per frequency. A receiver with one spatial mode (A Ω = λ²)
    and one polarisation receives N = ½ ρ E λ⁴/(π c) per hertz. Its beats with the local oscillator, from both sides of
    its frequency, cause a current noise of 4 R² P_LO N, compared with the shot noise 2 q R P_LO: the ratio is 2 R N/q,
    twice the electrons per mode. This is an upper bound: the whole field of view is assumed to be ground in full
    sunlight, and the optics to be lossless. The heterodyne efficiency does not apply, because sunlight fills any mode
    of the oscillator.
    """
    wavelength_m = instrument.waveform.wavelength_m
    irradiance_w_per_m3 = 1e6 * site.sunlight_w_per_m2_um
    per_hz_w = (
        0.5 * site.surface.reflectance * irradiance_w_per_m3 * wavelength_m**4 / (np.pi * SPEED_OF_LIGHT_MPS)
    )
    return float(2.0 * instrument.receiver.responsivity_a_per_w * per_hz_w / ELEMENTARY_CHARGE_C)


def snr_per_w(instrument: Instrument, site: Site | None) -> float:
    """Carrier-to-noise ratio of an echo in a rectangular bin, per watt of echo.

    It is the number of photons detected coherently in a record, η_h η_q P T_rec / hν, divided by one plus the ratios of
    all other noise to the local oscillator's shot noise.
    """
    receiver = instrument.receiver
    photons = instrument.optics.heterodyne_efficiency * receiver.responsivity_a_per_w
    photons *= instrument.waveform.record_time_s
    return photons / (ELEMENTARY_CHARGE_C * sum(noise_over_shot(instrument, site)))


def noise_over_shot(instrument: Instrument, site: Site | None) -> tuple[float, float]:
    """Ratios to the local oscillator's shot noise: of all noise ahead of the amplifier's poles, and of the digitiser's.

    The current noise densities are: shot noise 2 q R P_LO, dark current 2 q I_d, thermal 4kT/R_f, intensity noise RIN
    (R P_LO)² after common-mode rejection, sunlight in the receiver's own mode, and the digitiser's (full scale /
    2^bits)² / 12 spread from 0 to half the sample rate.
    """
    receiver, waveform = instrument.receiver, instrument.waveform
    shot_noise_a2_per_hz = shot_a2_per_hz(receiver)
    others = 4.0 * BOLTZMANN_J_PER_K * receiver.temperature_k / receiver.transimpedance_ohm
    others += 2.0 * ELEMENTARY_CHARGE_C * receiver.dark_current_a
    if receiver.relative_intensity_noise_db_per_hz is not None:
        current_a = receiver.responsivity_a_per_w * receiver.local_oscillator_power_w
        level_db_per_hz = receiver.relative_intensity_noise_db_per_hz - receiver.common_mode_rejection_db
        others += 10.0 ** (level_db_per_hz / 10.0) * current_a**2
    digitiser = 0.0
    if receiver.adc is not None:
        step_v = receiver.adc.full_scale_v / 2.0**receiver.adc.effective_bits
        digitiser = step_v**2 / 12.0 / receiver.transimpedance_ohm**2 / (0.5 * waveform.sample_rate_hz)
    sunlight = 0.0 if site is None else sunlight_over_shot(instrument, site)
    return 1.0 + sunlight + others / shot_noise_a2_per_hz, digitiser / shot_noise_a2_per_hz


def shot_a2_per_hz(receiver: Receiver) -> float:
    """Current noise density of the local oscillator's shot noise, 2 q R P_LO."""
    current_a = receiver.responsivity_a_per_w * receiver.local_oscillator_power_w
    return 2.0 * ELEMENTARY_CHARGE_C * current_a
