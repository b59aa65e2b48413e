"""Constants of the receiver's kernels, from an instrument and the light and atmosphere of a site."""

from __future__ import annotations

import numpy as np

from lidar_emu.errors import InputError
from lidar_emu.numerics.kernels import interpreted
from lidar_emu.receiver.analog_response import Response
from lidar_emu.receiver.false_alarms import neighbour_exceedance
from lidar_emu.receiver.link_budget import (
    ELEMENTARY_CHARGE_C,
    PLANCK_J_S,
    haze_w_per_m,
    noise_over_shot,
    shot_a2_per_hz,
    snr_per_w,
)
from lidar_emu.receiver.peak_interpolation import PEAK_METHODS
from lidar_emu.receiver.probability import threshold_power
from lidar_emu.receiver.range_speed_estimation import COMBINE_METHODS
from lidar_emu.receiver.receiver_model import (
    ALL_BEAMLETS,
    BackReflection,
    Haze,
    ReceiverModel,
    Ripple,
    SweepScatter,
)
from lidar_emu.receiver.residual_limit import build_residual_limit
from lidar_emu.receiver.skip_limits import (
    LEAST_FALSE_ALARM,
    LEAST_HAZE,
    LEAST_LINE_DRIFT,
    LEAST_RIPPLE,
    LEAST_SMEAR_BINS,
    MOST_PULL_BINS,
    allowed_variance_share,
)
from lidar_emu.receiver.spectrum import WINDOWS
from lidar_emu.receiver.stated_variance import build_variance_law, sweep_scatter
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument, Waveform
from lidar_emu.scenario.schema import LEFT_OUT_SHARE
from lidar_emu.scenario.site import Site


def build_receiver(
    instrument: Instrument,
    site: Site | None = None,
    left_out_share: float = LEFT_OUT_SHARE,
    in_turn: bool = False,
    ground_beamlets: int = ALL_BEAMLETS,
) -> ReceiverModel:
    """Compute the constants of an instrument's receiver.

    The signal in a bin follows from `link_budget.snr_per_w`. The threshold is the power that the noise, averaged
    over looks, exceeds with probability P_fa / (N/2).

    Args:
        instrument: the instrument.
        site: site, for sunlight and atmosphere; None: night in vacuum.
        left_out_share: see `FlightScenario`; 0 applies no skip rules.
        in_turn: beams are fired in turn, each in a cycle of the laser of its own.
        ground_beamlets: see `ReceiverModel`.

    Raises:
        InputError: the responsivity exceeds one electron per photon.
    """
    exact = left_out_share == 0.0
    waveform, detection, receiver = instrument.waveform, instrument.detection, instrument.receiver
    _refuse_gain(instrument)
    slope = waveform.chirp_slope_hz_per_s * (1.0 + waveform.slope_error)
    carrier_hz = SPEED_OF_LIGHT_MPS / waveform.wavelength_m
    bin_hz, record_s = waveform.bin_width_hz, waveform.record_time_s
    amplifier, digitiser = noise_over_shot(instrument, site)
    per_w = snr_per_w(instrument, site)
    window = WINDOWS[detection.window]
    looks = detection.looks
    threshold = interpreted(threshold_power)(-instrument.log_false_alarm_per_bin, looks) / looks
    return ReceiverModel(
        fft_length=float(waveform.fft_length),
        looks=looks,
        wavelength_m=waveform.wavelength_m,
        divergence_rad=waveform.wavelength_m / (np.pi * instrument.optics.waist_radius_m),
        range_bin_m=waveform.range_bin_m,
        speed_bin_mps=waveform.speed_bin_mps,
        bin_width_hz=bin_hz,
        beat_bin_per_m=2.0 * slope / (SPEED_OF_LIGHT_MPS * bin_hz),
        delay_per_m=2.0 / (SPEED_OF_LIGHT_MPS * record_s),
        slope_over_carrier_per_m=2.0 * slope / (SPEED_OF_LIGHT_MPS * carrier_hz),
        carrier_ratio=(
            1.0 - slope * record_s / 2.0 / carrier_hz,
            1.0,
            1.0 - slope * (waveform.segment_time_s - record_s / 2.0) / carrier_hz,
        ),
        segment_records=waveform.segment_time_s / record_s,
        cycle_records=waveform.cycle_time_s / record_s,
        record_time_s=record_s,
        furthest_record_s=instrument.furthest_record_s,
        snr_per_w=per_w,
        signal_shot_per_w=1.0 / (receiver.local_oscillator_power_w * amplifier),
        response=_response(instrument, amplifier, digitiser),
        ground_beamlets=ground_beamlets,
        haze=_haze(instrument, site, per_w, threshold),
        back_reflection=_back_reflection(instrument, per_w),
        linewidth_bins=waveform.linewidth_hz / bin_hz,
        ripple=_ripple(waveform, exact),
        sweep_scatter=SweepScatter(*sweep_scatter(waveform, detection), per_beam=in_turn),
        speckle=instrument.optics.speckle,
        window=window,
        noise_power=window.noise_power,
        # With averaged looks, the neighbours of a noise peak exceed the threshold nearly independently.
        independent_share=1.0 - neighbour_exceedance(window, threshold) if looks == 1 else 1.0,
        lowest_bin=detection.lowest_beat_hz / bin_hz,
        threshold=threshold,
        group_power_share=detection.group_fraction**2,
        peak_method=PEAK_METHODS[detection.peak],
        combine_method=COMBINE_METHODS[detection.combine],
        residual_limit=build_residual_limit(instrument),
        variance_law=build_variance_law(waveform, detection),
        least_segments=2 if detection.rule == "any_two" else 3,
        maximum_range_m=detection.maximum_range_m,
        record_edge_range_m=waveform.record_edge_range_m,
        variance_share=allowed_variance_share(left_out_share, instrument),
        least_smear_bins=0.0 if exact else LEAST_SMEAR_BINS,
        least_line_drift=0.0 if exact else LEAST_LINE_DRIFT,
        least_false_alarm=0.0 if exact else LEAST_FALSE_ALARM,
        sampled_length=float(waveform.fft_length),
        lost_segments=0,
        opposite_doppler_sign=False,
    )


def _response(instrument: Instrument, amplifier: float, digitiser: float) -> Response:
    receiver, waveform = instrument.receiver, instrument.waveform
    bin_hz, length = waveform.bin_width_hz, waveform.fft_length
    lowpass_bin = np.inf if receiver.bandwidth_hz is None else receiver.bandwidth_hz / bin_hz
    full_scale = np.inf
    if receiver.adc is not None:
        noise_a2 = (amplifier + digitiser) * shot_a2_per_hz(receiver) * 0.5 * waveform.sample_rate_hz
        # White noise of unit power per bin has the variance N/4, on a scale where a tone of unit weight has the
        # amplitude 1.
        noise_v = receiver.transimpedance_ohm * np.sqrt(noise_a2)
        full_scale = 0.5 * receiver.adc.full_scale_v / noise_v * np.sqrt(length / 4.0)
    turns = lowpass_bin / length
    # White noise behind a pole, in all Nyquist zones, over the noise ahead of it.
    passed = np.pi * turns if np.isfinite(turns) else 1.0
    return Response(
        lowpass_bin=float(lowpass_bin),
        highpass_bin=receiver.ac_coupling_hz / bin_hz,
        fold_scale=float(np.pi * turns * -np.expm1(-4.0 * np.pi * turns)),
        fold_decay=float(np.exp(-2.0 * np.pi * turns)),
        mean_noise=float((amplifier * passed + digitiser) / (amplifier + digitiser)),
        amplifier_noise=amplifier / (amplifier + digitiser),
        digitiser_noise=digitiser / (amplifier + digitiser),
        full_scale=float(full_scale),
    )


def _haze(instrument: Instrument, site: Site | None, per_w: float, threshold: float) -> Haze:
    waist_m, wavelength_m = instrument.optics.waist_radius_m, instrument.waveform.wavelength_m
    rayleigh_m = float(np.pi * waist_m**2 / wavelength_m)
    air = None if site is None else site.atmosphere
    if air is None or air.backscatter_per_m_sr == 0.0:
        return Haze(0.0, 0.0, rayleigh_m, 0.0)
    snr_per_m = haze_w_per_m(instrument, air) * per_w
    looks = instrument.detection.looks
    typical = interpreted(threshold_power)(LEAST_HAZE, looks) / looks
    # Haze that raises a bin's mean to this power exceeds the threshold with the probability exp(-LEAST_HAZE).
    least_per_m = (threshold / typical - 1.0) / instrument.waveform.range_bin_m

    def stronger(range_m: float) -> bool:
        spread = 1.0 + (range_m / rayleigh_m) ** 2
        return bool(snr_per_m * np.exp(-2.0 * air.extinction_per_m * range_m) / spread > least_per_m)

    low_m, high_m = 0.0, instrument.waveform.record_edge_range_m
    for _ in range(40):
        middle_m = 0.5 * (low_m + high_m)
        low_m, high_m = (middle_m, high_m) if stronger(middle_m) else (low_m, middle_m)
    return Haze(snr_per_m, air.extinction_per_m, rayleigh_m, low_m if stronger(0.0) else 0.0)


def _back_reflection(instrument: Instrument, per_w: float) -> BackReflection:
    optics = instrument.optics
    level_db = -np.inf if optics.back_reflection_db is None else optics.back_reflection_db
    return BackReflection(
        snr=float(per_w * optics.laser_power_w * 10.0 ** (level_db / 10.0)),
        range_m=optics.back_reflection_range_m,
    )


def _ripple(waveform: Waveform, exact: bool) -> Ripple:
    return Ripple(
        largest_index=2.0 * waveform.ripple_hz / waveform.ripple_frequency_hz,
        frequency_bin=waveform.ripple_frequency_hz / waveform.bin_width_hz,
        orders=float(waveform.ripple_orders),
        pull_bin=min(waveform.ripple_frequency_hz / waveform.bin_width_hz, MOST_PULL_BINS),
        least_index=0.0 if exact else LEAST_RIPPLE,
    )


def _refuse_gain(instrument: Instrument) -> None:
    wavelength_m = instrument.waveform.wavelength_m
    limit_a_per_w = ELEMENTARY_CHARGE_C * wavelength_m / (PLANCK_J_S * SPEED_OF_LIGHT_MPS)
    given_a_per_w = instrument.receiver.responsivity_a_per_w
    if given_a_per_w > limit_a_per_w:
        raise InputError(
            f"instrument {instrument.name}",
            "receiver.responsivity_a_per_w",
            given_a_per_w,
            f"must be at most {limit_a_per_w:.4f} A/W, one electron per photon at {wavelength_m * 1e9:g} nm",
        )
