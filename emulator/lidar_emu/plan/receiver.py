"""Receiver stages computed and left out on a flight, with error bounds.

Some stages are left out for the whole run. Others depend on the state of each beam: they are compiled before shot 0 and
left out beam by beam.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lidar_emu.numerics.kernels import interpreted
from lidar_emu.plan import Decision, LeftOut, at_most
from lidar_emu.plan.beat_errors import BeatErrors
from lidar_emu.plan.motion import largest
from lidar_emu.receiver.back_reflection import reflection_bin, reflection_power
from lidar_emu.receiver.link_budget import sunlight_over_shot
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import TRAVEL, Echoes
from lidar_emu.receiver.skip_limits import (
    LEAST_FALSE_ALARM,
    LEAST_LEAKED_SNR,
    LEAST_LINE_DRIFT,
    LEAST_RIPPLE,
    LEAST_SMEAR_BINS,
    MOST_PULL_BINS,
    allowed_variance_share,
    negligible_bin2,
)
from lidar_emu.receiver.speckle import MOST_TRAVEL_PITCHES
from lidar_emu.receiver.speckle_field import PITCH_W
from lidar_emu.receiver.sweep_error import ripple_index, sweep_variance
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Detection, Instrument, Waveform
from lidar_emu.scenario.load import folded_range, folded_speed
from lidar_emu.scenario.schema import FlightScenario

SMEAR_BOUND = LEAST_SMEAR_BINS / (2 * np.pi)
"""Amplitude beside a line of the smear that is left out, relative to the line."""

SMEAR_SHIFT = 0.2
"""Shift of a peak by a drift of β bins over its record, relative to β², at most, 32 bins or more from 0 and N/2. A
parabola through rectangular bins beside a centred tone, which are 0 without drift, is shifted by up to β."""

WIDEST_STEP = 2.0
"""Step of a digitiser over the analogue noise up to which quantisation is white noise of a twelfth of a step squared:
beyond, samples without an echo have one value."""

LINE_BOUND_POWER = 0.03
"""Change of an echo's power by the laser linewidth that is left out: four sigma."""


def plan_receiver(scenario: FlightScenario, echoes: Echoes, errors: BeatErrors) -> list[Decision]:
    """Decide the receiver's stages from echoes sampled along the flight, with one beamlet per beam."""
    if scenario.level == "geometric":
        return [
            Decision("receiver", False, "ground truth", "the scenario specifies level geometric", "exact")
        ]
    reason = f"the scenario specifies level {scenario.level}"
    level = Decision("receiver", True, scenario.level, reason, _LEVEL[scenario.level])
    instrument = scenario.instrument
    model = build_receiver(instrument, scenario.site, scenario.left_out_share)
    folds = plan_ambiguity(scenario, largest(echoes.range_m), largest(echoes.closing_speed_mps))
    ripple = _ripple(scenario, model, echoes, errors)
    chain = _response(instrument), _digitiser(instrument, model), _back_reflection(instrument, model, echoes)
    if scenario.level == "reference":
        others = _scatterers_of_other_beams(scenario, echoes.fired.shape[1])
        return [level, folds, _scatterers(scenario), ripple, *chain, others]
    motion = _smear(scenario, echoes, errors), _line(scenario, echoes, errors)
    sweep, light = _sweep(scenario, model, echoes, errors), _light(scenario, model, echoes)
    speckle = _speckle(scenario, echoes, errors)
    return [level, folds, *motion, sweep, ripple, *speckle, *chain, *light, _false_alarms(scenario)]


_FOLDED = "beats folded at half the sample rate"

_LEVEL = {
    "spectral": "1e-11 of a spectrum's peak",
    "reference": "the light of scatterers",
}


def _scatterers(scenario: FlightScenario) -> Decision:
    air = scenario.site.atmosphere
    volume = "surface" if air is None or air.backscatter_per_m_sr == 0 else "surface and haze"
    narrowband = scenario.reference_samples == "narrowband"
    bound = "1e-3 of a spectrum's peak, no clipping" if narrowband else "every sample"
    reason = f"the scenario specifies reference_samples {scenario.reference_samples}"
    return Decision("scatterers", True, f"of {volume}, on the exact motion", reason, bound)


def plan_ambiguity(scenario: FlightScenario, farthest_m: float, fastest_mps: float) -> Decision:
    """Decide whether beats fold, from the longest range and the highest closing speed of a flight."""
    instrument, waveform = scenario.instrument, scenario.instrument.waveform
    half_m, half_mps = waveform.nyquist_range_m, waveform.unambiguous_speed_mps
    reason = f"up to {farthest_m:.0f} m and {fastest_mps:.3g} m/s; {_limits_of_folding(waveform)}"
    # An echo that arrives within the record folds, wherever the surfaces of this flight are.
    bounds = []
    doubtful_m = 2.0 * half_m - waveform.record_edge_range_m
    if farthest_m > half_m:
        bounds.append(folded_range(waveform, farthest_m))
    if doubtful_m <= farthest_m:
        bounds.append("no sign is resolved" + (f" beyond {doubtful_m:.0f} m" if doubtful_m > 0.0 else ""))
    if fastest_mps > half_mps:
        bounds.append(f"{folded_speed(waveform, fastest_mps)}, with its sign resolved")
    folds = farthest_m / half_m + fastest_mps / half_mps > 1.0
    if folds and not bounds:
        bounds.append(_choice_of_folds(instrument.detection))
    return Decision(
        "ambiguity", bool(bounds), _FOLDED if bounds else "-", reason, "; ".join(bounds) or "exact"
    )


def plan_unknown_ambiguity(instrument: Instrument) -> Decision:
    """State where beats fold on a flight with live truth."""
    reason = f"the trajectory is unknown before the run; {_limits_of_folding(instrument.waveform)}"
    return Decision("ambiguity", True, _FOLDED, reason, _choice_of_folds(instrument.detection))


def _limits_of_folding(waveform: Waveform) -> str:
    half_m, half_mps = waveform.nyquist_range_m, waveform.unambiguous_speed_mps
    return f"beats fold beyond {half_m:.6g} m, Doppler shifts beyond {half_mps:.4g} m/s"


def _choice_of_folds(detection: Detection) -> str:
    if detection.combine == "least_squares":
        return "the signs of least residual"
    return "the published detector ignores folds and errs there"


def _smear(scenario: FlightScenario, echoes: Echoes, errors: BeatErrors) -> Decision:
    waveform = scenario.instrument.waveform
    smear_bins = largest_smear_bins(waveform, echoes)
    reason = f"beats drift by up to {smear_bins:.2g} bin in a record"
    if scenario.left_out_share == 0.0:
        return Decision("smear and migration", True, "filter over bins", reason, "exact")
    bound = f"{100 * SMEAR_BOUND:.1g} % of a line's amplitude beside it"
    left_out_bins = min(smear_bins, LEAST_SMEAR_BINS)
    # The phase πβx² of a drift by β over a record x = ±½ has the variance (πβ)²/180.
    detection = scenario.instrument.detection
    empty_bins = detection.peak == "parabola" and detection.window == "rect"
    shift_bin = left_out_bins if empty_bins else SMEAR_SHIFT * left_out_bins**2
    effect = errors.bias(shift_bin, (np.pi * left_out_bins) ** 2 / 180)
    if smear_bins <= LEAST_SMEAR_BINS:
        return Decision("smear and migration", False, "-", reason, bound, effect)
    how = f"beams beyond {LEAST_SMEAR_BINS:g} bin"
    return Decision("smear and migration", True, how, reason, bound, effect)


def largest_smear_bins(waveform: Waveform, echoes: Echoes) -> float:
    """Compute the largest drift of a beat during its record by acceleration and range migration, in bins."""
    record_s = waveform.record_time_s
    by_motion = 2 * largest(echoes.closing_acceleration_mps2) / waveform.wavelength_m
    slope = waveform.chirp_slope_hz_per_s * (1 + waveform.slope_error)
    by_migration = 4 * slope * largest(echoes.closing_speed_mps) / SPEED_OF_LIGHT_MPS
    return float((by_motion + by_migration) * record_s**2)


def _line(scenario: FlightScenario, echoes: Echoes, errors: BeatErrors) -> Decision:
    waveform = scenario.instrument.waveform
    if waveform.linewidth_hz == 0:
        return Decision("laser line", False, "-", "linewidth_hz is 0", "exact")
    farthest_m = largest(echoes.range_m)
    drift = 4 * np.pi * waveform.linewidth_hz * farthest_m / SPEED_OF_LIGHT_MPS
    reason = f"phase variance up to {drift:.2g} over {farthest_m:.0f} m"
    if scenario.left_out_share == 0.0:
        return Decision("laser line", True, "filter over bins", reason, "exact")
    bound = f"{100 * LINE_BOUND_POWER:g} % of an echo's power, {_sigma_share(scenario)}"
    how = f"beams beyond {LEAST_LINE_DRIFT:g}, or whose scatter matters"
    effect = errors.scatter(_left_out_bin2(scenario, errors), min(drift, LEAST_LINE_DRIFT))
    return Decision("laser line", True, how, reason, bound, effect)


def _sweep(scenario: FlightScenario, model: ReceiverModel, echoes: Echoes, errors: BeatErrors) -> Decision:
    waveform = scenario.instrument.waveform
    if waveform.slope_scatter == 0 and waveform.flicker_hz2 == 0:
        return Decision("laser sweep", False, "-", "slope_scatter and flicker_hz2 are 0", "exact")
    farthest_m = largest(echoes.range_m)
    range_m, speed_mps = model.sweep_scatter.range_per_m, model.sweep_scatter.speed_mps_per_m
    reason = (
        f"chirps off by {range_m * farthest_m:.2g} m, constant segment by {speed_mps * farthest_m:.2g} m/s "
        f"at {farthest_m:.0f} m"
    )
    if scenario.left_out_share == 0.0:
        return Decision("laser sweep", True, "errors of each segment", reason, "exact")
    matters = any(
        interpreted(sweep_variance)(model, segment, range_m, left_out_bin2) > 0.0
        for range_m, left_out_bin2 in _lit_beams(model, echoes)
        for segment in (0, 1)
    )
    how = "beams whose scatter by it matters" if matters else "-"
    effect = errors.scatter(_left_out_bin2(scenario, errors))
    return Decision("laser sweep", matters, how, reason, _sigma_share(scenario), effect)


def _ripple(scenario: FlightScenario, model: ReceiverModel, echoes: Echoes, errors: BeatErrors) -> Decision:
    waveform = scenario.instrument.waveform
    if waveform.ripple_hz == 0:
        return Decision("ripple of the chirps", False, "-", "ripple_hz is 0", "exact")
    index = 2.0 * waveform.ripple_hz / waveform.ripple_frequency_hz
    reason = (
        f"modulates beats by up to {index:.2g} rad, {waveform.ripple_frequency_hz / 1e3:g} kHz to either side"
    )
    if scenario.left_out_share == 0.0 or scenario.level == "reference":
        how = "filter over bins" if scenario.level == "spectral" else "phase of the light"
        return Decision("ripple of the chirps", True, how, reason, "exact")
    matters = any(
        interpreted(ripple_index)(model, range_m, left_out_bin2) > 0.0
        for range_m, left_out_bin2 in _lit_beams(model, echoes)
    )
    how = f"filter over bins, beams beyond {LEAST_RIPPLE:g} rad, or whose scatter matters" if matters else "-"
    bound = f"{0.5 * LEAST_RIPPLE:g} of a line's amplitude, {_sigma_share(scenario)}"
    effect = errors.scatter(_left_out_bin2(scenario, errors), 0.5 * LEAST_RIPPLE**2)
    return Decision("ripple of the chirps", matters, how, reason, bound, effect)


def _lit_beams(model: ReceiverModel, echoes: Echoes) -> Iterator[tuple[float, float]]:
    power_w = echoes.power_w.sum(axis=-1)
    for beam in zip(*np.nonzero(power_w > 0.0), strict=True):
        yield float(echoes.range_m[beam][0]), interpreted(negligible_bin2)(model, float(power_w[beam]))


def _speckle(scenario: FlightScenario, echoes: Echoes, errors: BeatErrors) -> list[Decision]:
    if not scenario.instrument.optics.speckle:
        return [Decision("speckle", False, "-", "the instrument has none", "exact")]
    field = Decision("speckle", True, "a Gaussian weight per beamlet", "echoes fade", "correlation to 0.03")
    way = PITCH_W * largest(echoes.speckle_motion[..., TRAVEL])
    way *= scenario.instrument.waveform.record_time_s
    what, reason = "speckle within a record", f"up to {way:.2g} waists of way in a record"
    if way == 0.0:
        return [field, Decision(what, False, "-", reason, "exact")]
    exact = scenario.left_out_share == 0.0
    how = "several tones per beamlet" if exact else "beams whose scatter by it matters"
    bound = "7 % of the change" if exact else _sigma_share(scenario)
    effect = None if exact else errors.line(_share(scenario))
    longest = PITCH_W * MOST_TRAVEL_PITCHES
    if way > longest:
        bound = f"lines at most as wide as of {longest:.3g} waists: spread and loss too small beyond"
        effect = None
    return [field, Decision(what, True, how, reason, bound, effect)]


def _share(scenario: FlightScenario) -> float:
    return allowed_variance_share(scenario.left_out_share, scenario.instrument)


def _left_out_bin2(scenario: FlightScenario, errors: BeatErrors) -> float:
    """Variance of a beat that a stage may leave out, of the weakest beam."""
    return _share(scenario) * errors.variance_bin2


def _sigma_share(scenario: FlightScenario) -> str:
    return f"{at_most(50.0 * _share(scenario))} % of sigma"


def _response(instrument: Instrument) -> Decision:
    receiver = instrument.receiver
    if receiver.bandwidth_hz is None and receiver.ac_coupling_hz == 0:
        return Decision("frequency response", False, "-", "flat and directly coupled", "exact")
    poles = [f"{hz / 1e3:g} kHz" for hz in (receiver.ac_coupling_hz, receiver.bandwidth_hz) if hz]
    return Decision(
        "frequency response", True, "gain of each tone, coloured noise", ", ".join(poles), "exact"
    )


def _digitiser(instrument: Instrument, model: ReceiverModel) -> Decision:
    if instrument.receiver.adc is None:
        return Decision("digitiser", False, "-", "the instrument has an ideal digitiser", "exact")
    bits = f"{instrument.receiver.adc.effective_bits:g} effective bits"
    bound = "harmonics of a clipped tone are modelled as noise; its gain is accurate to 12 %"
    quantisation = model.response.digitiser_noise
    analogue = max(model.response.mean_noise - quantisation, np.finfo(float).tiny)
    steps = float(np.sqrt(12.0 * quantisation / analogue))
    if steps > WIDEST_STEP:
        bound = f"quantisation is not white: a step is {steps:.2g} times the analogue noise"
    return Decision("digitiser", True, "noise, clipping", bits, bound)


def _back_reflection(instrument: Instrument, model: ReceiverModel, echoes: Echoes) -> Decision:
    if instrument.optics.back_reflection_db is None:
        return Decision("back-reflection", False, "-", "back_reflection_db is null", "exact")
    beat_bin, snr = interpreted(reflection_bin)(model, 2), interpreted(reflection_power)(model, 2)
    brightest = largest(echoes.power_w) * model.snr_per_w
    reason = (
        f"{10.0 * np.log10(snr / brightest):.0f} dB over the strongest echo of a beamlet, "
        f"at {beat_bin * model.bin_width_hz / 1e3:.3g} kHz"
    )
    if beat_bin + 2.0 < model.lowest_bin:
        reason += ", below lowest_beat_hz"
    bound = "weak echoes beside a clipped line to 5 dB"
    return Decision("back-reflection", True, "a steady line of the chirps", reason, bound)


def _scatterers_of_other_beams(scenario: FlightScenario, beams: int) -> Decision:
    leakage_db = scenario.instrument.optics.leakage_db
    if leakage_db is None or beams < 2:
        return _no_leakage(leakage_db)
    reason = f"leakage_db is {leakage_db:g}"
    return Decision("leakage between beams", True, "light of all beams", reason, "exact")


def _no_leakage(leakage_db: float | None) -> Decision:
    reason = "leakage_db is null" if leakage_db is None else "there is one beam"
    return Decision("leakage between beams", False, "-", reason, "exact")


def plan_leakage(scenario: FlightScenario, echoes: Echoes, errors: BeatErrors) -> Decision:
    """Decide whether beams receive the echoes of others."""
    leakage_db = scenario.instrument.optics.leakage_db
    if leakage_db is None or echoes.fired.shape[1] < 2:
        return _no_leakage(leakage_db)
    exact = scenario.left_out_share == 0.0
    model = build_receiver(scenario.instrument, scenario.site, scenario.left_out_share)
    power_w = np.where(echoes.fired, echoes.power_w.sum(axis=-1), 0.0)
    leaked_w = 10.0 ** (leakage_db / 10.0) * (power_w.sum(axis=1, keepdims=True) - power_w)
    lit = power_w > 0.0
    share = leaked_w[lit] / power_w[lit]
    snr = float(leaked_w.max(initial=0.0)) * model.snr_per_w
    moved_bin2 = 0.5 * MOST_PULL_BINS**2 * share
    left_out_bin2 = np.array([interpreted(negligible_bin2)(model, each) for each in power_w[lit]])
    reason = (
        f"up to {np.sqrt(share.max(initial=0.0)):.2g} of an echo's amplitude, "
        f"{10.0 * np.log10(max(snr, 1e-30)):.0f} dB of the noise"
    )
    if exact or snr > LEAST_LEAKED_SNR or (moved_bin2 > left_out_bin2).any():
        return Decision("leakage between beams", True, "echoes of all beams", reason, "speckle of its own")
    bound = f"{_sigma_share(scenario)}, {LEAST_LEAKED_SNR:g} of the noise"
    # It exceeds the threshold no more often than five bins of noise do.
    alarms = min(1.0, 15.0 * np.exp(scenario.instrument.log_false_alarm_per_bin))
    effect = errors.scatter(_left_out_bin2(scenario, errors))._replace(detection_probability=alarms)
    return Decision("leakage between beams", False, "-", reason, bound, effect)


def _light(scenario: FlightScenario, model: ReceiverModel, echoes: Echoes) -> list[Decision]:
    site = scenario.site
    ratio = sunlight_over_shot(scenario.instrument, site)
    if ratio == 0:
        sun = Decision("sunlight", False, "-", f"night at {site.name}", "exact")
    else:
        sun = Decision("sunlight", True, "noise", f"{10 * np.log10(ratio):.0f} dB of shot noise", "exact")
    air = site.atmosphere
    if air is None or air.backscatter_per_m_sr == 0:
        return [sun, Decision("haze", False, "-", f"{site.name} has no backscatter", "exact")]
    return [sun, _haze(model, echoes)]


def _haze(model: ReceiverModel, echoes: Echoes) -> Decision:
    from lidar_emu.plan.detection_forecast import largest_haze_locks

    chirp, constant = largest_haze_locks(model, echoes)
    computed_m = model.haze.computed_range_m
    how = "a line; a band in the chirps"
    how += f", bin by bin up to {computed_m:.0f} m" if computed_m > 0.0 else ", its highest bins"
    chirps, segments = (f"{at_most(100.0 * share)} %" for share in (chirp, constant))
    reason = f"up to {chirps} of chirps and {segments} of constant segments lock on it"
    return Decision("haze", True, how, reason, "single scattering, independent records")


def _false_alarms(scenario: FlightScenario) -> Decision:
    if scenario.left_out_share == 0.0:
        return Decision("false alarms", True, "highest of all bins", "every bin has noise", "exact")
    bound = f"{LEAST_FALSE_ALARM:g} of the spectra"
    effect = LeftOut(detection_probability=3 * LEAST_FALSE_ALARM)
    how = "unless the echo is too strong"
    return Decision("false alarms", True, how, "every bin has noise", bound, effect)
