"""What the receiver computes on a flight, what it leaves out, and what that costs at most.

Some stages are ruled out for the whole run; others depend on the state of each beam, are compiled with the rest before
shot 0, and are left out beam by beam.
"""

from __future__ import annotations

import numpy as np

from lidar_emu.fmcw.returns import Echoes
from lidar_emu.fmcw.skip_limits import LEAST_FALSE_ALARM, LEAST_LINE_DRIFT, LEAST_SMEAR_BINS
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.plan.plan import Decision
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument, Waveform
from lidar_emu.scenario.schema import FlightScenario

SMEAR_BOUND = LEAST_SMEAR_BINS / (2 * np.pi)
"""Amplitude that the smear left out has beside a line, over the line's."""

LINE_BOUND_POWER, LINE_BOUND_BINS = 0.03, 0.03
"""What the laser's line left out changes in an echo's power and in the frequency of its line: four sigma."""


def plan_receiver(scenario: FlightScenario, echoes: Echoes) -> list[Decision]:
    """The receiver's stages, from a look at the echoes along the flight, one beamlet for each beam."""
    if scenario.level == "geometric":
        return [Decision("receiver", False, "truth", "the scenario asks for level geometric", "exact")]
    level = Decision(
        "receiver",
        True,
        scenario.level,
        f"the scenario asks for level {scenario.level}",
        _LEVEL[scenario.level],
    )
    return [
        level,
        _motion(scenario, echoes),
        _smear(scenario, echoes),
        _line(scenario, echoes),
        _speckle(scenario),
        _response(scenario.instrument),
        _clipping(scenario.instrument),
        *_light(scenario),
        _false_alarms(scenario),
    ]


_LEVEL = {
    "statistical": "one frequency for each segment's spectrum",
    "spectral": "1e-11 of a spectrum's peak",
    "waveform": "every sample",
}


def _motion(scenario: FlightScenario, echoes: Echoes) -> Decision:
    waveform = scenario.instrument.waveform
    fastest_mps2 = _largest(echoes.closing_acceleration_mps2)
    # Between up- and down-chirp the speed changes by 2 T a, which reads as range.
    bias_m = SPEED_OF_LIGHT_MPS * waveform.segment_time_s * fastest_mps2
    bias_m /= waveform.wavelength_m * waveform.chirp_slope_hz_per_s
    reason = f"{fastest_mps2:.3g} m/s² makes {bias_m:.2g} m of range, near when slowing down"
    half_s = waveform.segment_time_s * (1.5 * scenario.instrument.detection.looks - 0.5)
    curving_m = 0.5 * fastest_mps2 * half_s**2
    return Decision(
        "motion in a shot", True, "each segment's own time", reason, f"{curving_m:.1g} m of range"
    )


def _smear(scenario: FlightScenario, echoes: Echoes) -> Decision:
    waveform = scenario.instrument.waveform
    smear_bins = largest_smear_bins(waveform, echoes)
    reason = f"beats change by up to {smear_bins:.2g} bin in a record"
    if scenario.exact:
        return Decision("smear and migration", True, "filter over bins", reason, "exact")
    bound = f"{100 * SMEAR_BOUND:.1g} % of a line's amplitude beside it"
    if smear_bins <= LEAST_SMEAR_BINS:
        return Decision("smear and migration", False, "-", reason, bound)
    return Decision("smear and migration", True, f"beams beyond {LEAST_SMEAR_BINS:g} bin", reason, bound)


def largest_smear_bins(waveform: Waveform, echoes: Echoes) -> float:
    """The largest change of a beat during its record, by acceleration and by migration, in bins."""
    record_s = waveform.record_time_s
    by_motion = 2 * _largest(echoes.smear_acceleration_mps2) / waveform.wavelength_m
    slope = waveform.chirp_slope_hz_per_s * (1 + waveform.slope_error)
    by_migration = 4 * slope * _largest(echoes.closing_speed_mps) / SPEED_OF_LIGHT_MPS
    return float((by_motion + by_migration) * record_s**2)


def _line(scenario: FlightScenario, echoes: Echoes) -> Decision:
    waveform = scenario.instrument.waveform
    if waveform.linewidth_hz == 0:
        return Decision("laser line", False, "-", "linewidth_hz is 0", "exact")
    if waveform.linewidth_model == "coherent":
        return Decision(
            "laser line", True, "published convolution", "linewidth_model is coherent", "as published"
        )
    farthest_m = _largest(echoes.range_m)
    drift = 4 * np.pi * waveform.linewidth_hz * farthest_m / SPEED_OF_LIGHT_MPS
    reason = f"phase variance up to {drift:.2g} over {farthest_m:.0f} m"
    if scenario.exact:
        return Decision("laser line", True, "filter over bins", reason, "exact")
    bound = f"{100 * LINE_BOUND_POWER:g} % of an echo's power, {LINE_BOUND_BINS:g} bin"
    if drift <= LEAST_LINE_DRIFT:
        return Decision("laser line", False, "-", reason, bound)
    return Decision("laser line", True, f"beams beyond {LEAST_LINE_DRIFT:g}", reason, bound)


def _speckle(scenario: FlightScenario) -> Decision:
    if not scenario.instrument.optics.speckle:
        return Decision("speckle", False, "-", "the instrument has none", "exact")
    return Decision("speckle", True, "a Gaussian weight per beamlet", "echoes fade", "correlation to 0.035")


def _response(instrument: Instrument) -> Decision:
    receiver = instrument.receiver
    if receiver.bandwidth_hz is None and receiver.ac_coupling_hz == 0:
        return Decision("frequency response", False, "-", "flat and directly coupled", "exact")
    poles = [f"{hz / 1e3:g} kHz" for hz in (receiver.ac_coupling_hz, receiver.bandwidth_hz) if hz]
    return Decision(
        "frequency response", True, "gain of each tone, coloured noise", ", ".join(poles), "exact"
    )


def _clipping(instrument: Instrument) -> Decision:
    if instrument.receiver.adc is None:
        return Decision("digitiser", False, "-", "the instrument's is ideal", "exact")
    bits = f"{instrument.receiver.adc.effective_bits:g} effective bits"
    bound = "harmonics of a clipped tone come as noise, its gain to 12 %"
    return Decision("digitiser", True, "noise, clipping", bits, bound)


def _light(scenario: FlightScenario) -> list[Decision]:
    from lidar_emu.fmcw.link_budget import sunlight_over_shot

    site = scenario.site
    ratio = sunlight_over_shot(scenario.instrument, site)
    if ratio == 0:
        sun = Decision("sunlight", False, "-", f"night at {site.name}", "exact")
    else:
        sun = Decision("sunlight", True, "noise", f"{10 * np.log10(ratio):.0f} dB of shot noise", "exact")
    air = site.atmosphere
    if air is None or air.backscatter_per_m_sr == 0:
        return [sun, Decision("backscatter", False, "-", f"{site.name} has no haze", "exact")]
    if scenario.level != "spectral":
        missing = "the air's own line is missing"
        return [sun, Decision("backscatter", False, "-", f"not at level {scenario.level}", missing)]
    return [
        sun,
        Decision(
            "backscatter", True, "a line and noise", f"{air.backscatter_per_m_sr:g} /m/sr", "first order"
        ),
    ]


def _false_alarms(scenario: FlightScenario) -> Decision:
    if scenario.exact:
        return Decision("false alarms", True, "highest of all bins", "noise is everywhere", "exact")
    bound = f"{LEAST_FALSE_ALARM:g} of the spectra"
    return Decision("false alarms", True, "unless the echo is too strong", "noise is everywhere", bound)


def _largest(values: FloatArray) -> float:
    return float(np.nanmax(np.abs(values), initial=0.0))
