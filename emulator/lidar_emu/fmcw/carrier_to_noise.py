"""Carrier-to-noise ratio: photons of the echo over shot, amplifier, digitiser and sunlight noise, in a bin."""

from __future__ import annotations

from lidar_emu.fmcw.link_budget import sunlight_over_shot
from lidar_emu.fmcw.physical_constants import BOLTZMANN_J_PER_K, ELEMENTARY_CHARGE_C
from lidar_emu.scenario.instrument import Instrument, Receiver
from lidar_emu.scenario.site import Site


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
    others += _intensity_a2_per_hz(receiver, receiver.relative_intensity_noise_db_per_hz)
    digitiser = 0.0
    if receiver.adc is not None:
        step_v = receiver.adc.full_scale_v / 2.0**receiver.adc.effective_bits
        digitiser = step_v**2 / 12.0 / receiver.transimpedance_ohm**2 / (0.5 * waveform.sample_rate_hz)
    sunlight = 0.0 if site is None else sunlight_over_shot(instrument, site)
    return 1.0 + sunlight + others / shot_noise_a2_per_hz, digitiser / shot_noise_a2_per_hz


def _intensity_a2_per_hz(receiver: Receiver, level_db_per_hz: float | None) -> float:
    """Current noise density of relative intensity noise after common-mode rejection."""
    if level_db_per_hz is None:
        return 0.0
    current_a = receiver.responsivity_a_per_w * receiver.local_oscillator_power_w
    return float(10.0 ** ((level_db_per_hz - receiver.common_mode_rejection_db) / 10.0) * current_a**2)


def shot_a2_per_hz(receiver: Receiver) -> float:
    """Current noise density of the local oscillator's shot noise, 2 q R P_LO."""
    current_a = receiver.responsivity_a_per_w * receiver.local_oscillator_power_w
    return 2.0 * ELEMENTARY_CHARGE_C * current_a
