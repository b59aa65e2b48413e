"""Table of docs/physics.md: sizes of error sources that no shipped scenario has, on every shipped flight.

Each source is a closed form with typical values, evaluated for the beams of shots along a flight, and compared with the
expected sigma of the same beams: rms over rms, weighted with the probability of detection.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import exp, log, log10, pi, sqrt
from typing import NamedTuple

import numpy as np

from benchmarks.tables import Part
from lidar_emu.beams.flight import Flight
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import interpreted
from lidar_emu.plan.expected_error import BeamErrors, beam_errors
from lidar_emu.receiver.link_budget import ELEMENTARY_CHARGE_C, noise_over_shot
from lidar_emu.receiver.peak_interpolation import CRAMER_RAO_BIN2, EFFICIENCY, PEAK_METHODS
from lidar_emu.receiver.range_speed_estimation import BEAT_WEIGHTS, COMBINE_METHODS
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.spectrum import fold
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument
from lidar_emu.scenario.load import load, shipped_scenarios
from lidar_emu.scenario.schema import FlightScenario

BUILD_ABOVE = 0.05

RESIDUAL = 5e-5
"""Rms deviation of the laser's frequency from a linear sweep, relative to the sweep."""
RIPPLE_HZ = 10e3
FLICKER_HZ2 = 1e6
RIN_PEAK_DB_PER_HZ, RIN_PEAK_HZ, RIN_HALF_WIDTH_HZ = -105.0, 1e6, 1e5
RETURN_LOSS_DB, REFLECTION_M = 60.0, 1.0
SLOWEST_RECOVERY_S = 13e-6
CROSSTALK_DB = 50.0
APERTURE_JITTER_S, TRIGGER_JITTER_S = 1e-12, 1e-9
CLOCK_ERROR = 1e-6
WAVELENGTH_DRIFT_M = 1e-12
POINTING_DRIFT_RAD = 23e-6
DROOP = 0.01
POLARISATION_LOSS = 0.01

Errors = tuple[FloatArray, FloatArray]
"""Rms errors (shots, beams) of range in metres and of closing speed in metres per second."""


class Flown(NamedTuple):
    """A shipped flight with the errors of its beams."""

    name: str
    instrument: Instrument
    beams: BeamErrors

    @property
    def delay_s(self) -> FloatArray:
        """Delay of each echo, (shots, beams)."""
        return 2.0 * self.beams.hits.range_m / SPEED_OF_LIGHT_MPS

    @property
    def speed_mps(self) -> FloatArray:
        """Closing speeds, (shots, beams)."""
        return self.beams.echoes.closing_speed_mps[..., 0]

    def rms(self, values: FloatArray) -> float:
        """Rms over beams, weighted with their probability of detection."""
        weight = np.where(self.beams.expected, self.beams.detected, 0.0)
        known = (weight > 0.0) & np.isfinite(values)
        return float(np.sqrt(np.average(values[known] ** 2, weights=weight[known])))

    def from_beats(self, variance_hz2: FloatArray) -> Errors:
        """Errors from independent variances (3, shots, beams) of the three beats."""
        waveform = self.instrument.waveform
        method = COMBINE_METHODS[self.instrument.detection.combine]
        weights = np.moveaxis(BEAT_WEIGHTS[method][(self.speed_mps < 0.0).astype(int)], (-2, -1), (0, 1))
        range_bin2, speed_bin2 = (weights**2 * variance_hz2).sum(axis=1) / waveform.bin_width_hz**2
        return np.sqrt(range_bin2) * waveform.range_bin_m, np.sqrt(speed_bin2) * waveform.speed_bin_mps

    def observed_hz(self) -> FloatArray:
        """Beats folded to the band, (3, shots, beams)."""
        waveform = self.instrument.waveform
        folded = np.vectorize(lambda bin_: interpreted(fold)(bin_, waveform.fft_length)[0], otypes=[float])
        return np.asarray(folded(np.nan_to_num(self.beams.beats_bin))) * waveform.bin_width_hz

    def noise_variance_hz2(self, excess: FloatArray) -> FloatArray:
        """Variances of beats by noise of `excess` times the present noise, at most a uniform bin's."""
        efficiency = EFFICIENCY[PEAK_METHODS[self.instrument.detection.peak]]
        variance_bin2 = np.minimum(efficiency * CRAMER_RAO_BIN2 * excess / self.beams.snr, 1.0 / 12.0)
        return variance_bin2 * self.instrument.waveform.bin_width_hz**2


def parabola(x: FloatArray | float) -> FloatArray:
    """3 (sin x - x cos x)/x³: transform of the weights of least squares on the phase, at x = π f T_rec."""
    return np.asarray(3.0 * (np.sin(x) - x * np.cos(x)) / np.asarray(x) ** 3)


def pull(apart_bin: FloatArray) -> FloatArray:
    """Offset of a peak by half bins on a bin, by another tone, per its relative amplitude; at most.

    The filters of the 13 bins pass the tone by 4/π, and their ratio has the slope 2 - 2/13.
    """
    bins = np.arange(-6, 7)
    difference = np.sinc(0.5 - bins) - np.sinc(0.5 + bins)
    passed = np.sinc(apart_bin[..., None] - bins) @ difference
    return np.asarray(np.abs(passed) * pi / 4.0 / (2.0 - 2.0 / 13.0))


def ripple(flown: Flown) -> Errors:
    """Chirp non-linearity, periodic: 2A sin(πf_mτ) of beat, weighted over the record; the phase is arbitrary."""
    waveform = flown.instrument.waveform
    deviation_hz = RESIDUAL * waveform.chirp_slope_hz_per_s * waveform.segment_time_s
    weight = parabola(pi * RIPPLE_HZ * waveform.record_time_s)
    beat_hz = 2.0 * deviation_hz * np.sin(pi * RIPPLE_HZ * flown.delay_s) * weight
    return flown.from_beats(np.stack([beat_hz**2, 0.0 * beat_hz, beat_hz**2]))


def slope_changes(flown: Flown) -> Errors:
    """Chirp non-linearity, random: a residual of √12 r of the slope, independent from sweep to sweep."""
    beat_hz = sqrt(12.0) * RESIDUAL * flown.instrument.waveform.chirp_slope_hz_per_s * flown.delay_s
    return flown.from_beats(np.stack([beat_hz**2, 0.0 * beat_hz, beat_hz**2]))


def flicker(flown: Flown) -> Errors:
    """1/f noise of the laser's frequency, k/f: σ = 3τ sqrt(k)/T_rec in each segment."""
    variance_hz2 = 9.0 * FLICKER_HZ2 * (flown.delay_s / flown.instrument.waveform.record_time_s) ** 2
    return flown.from_beats(np.stack([variance_hz2] * 3))


def flicker_width_hz(observed_s: float) -> float:
    """Width that 1/f noise gives the laser's line in a time: sqrt(8 ln 2 A), A the noise above 8 ln 2 f/π² [2]."""
    highest_hz = pi * sqrt(FLICKER_HZ2 / (8.0 * log(2.0)))
    return sqrt(8.0 * log(2.0) * FLICKER_HZ2 * log(highest_hz * observed_s))


def rin_peak(flown: Flown) -> Errors:
    """Relaxation oscillation in the intensity noise: excess noise at beats near its frequency."""
    receiver = flown.instrument.receiver
    current_a = receiver.responsivity_a_per_w * receiver.local_oscillator_power_w
    rejected = 10.0 ** ((RIN_PEAK_DB_PER_HZ - receiver.common_mode_rejection_db) / 10.0)
    excess = rejected * current_a / (2.0 * ELEMENTARY_CHARGE_C) / sum(noise_over_shot(flown.instrument, None))
    away = (flown.observed_hz() - RIN_PEAK_HZ) / RIN_HALF_WIDTH_HZ
    return flown.from_beats(flown.noise_variance_hz2(excess / (1.0 + away**2)))


def crosstalk(flown: Flown) -> Errors:
    """Echoes of the other beams, attenuated: each pulls the peak, by sqrt(1/2) of the most at a random phase."""
    waveform, power_w = flown.instrument.waveform, flown.beams.echoes.power_w[..., 0]
    beats_hz = flown.observed_hz()
    variance_bin2 = np.zeros_like(beats_hz)
    beams = power_w.shape[1]
    for other in range(beams):
        apart_bin = (beats_hz - beats_hz[..., other, None]) / waveform.bin_width_hz
        share = 10.0 ** (-CROSSTALK_DB / 10.0) * power_w[:, other, None] / np.maximum(power_w, 1e-30)
        others = np.arange(beams) != other
        variance_bin2 += np.where(others, 0.5 * np.nan_to_num(share) * pull(apart_bin) ** 2, 0.0)
    return flown.from_beats(variance_bin2 * waveform.bin_width_hz**2)


def jitter(flown: Flown) -> Errors:
    """Aperture jitter: noise 2K/N (2πgσ)² in each bin; trigger jitter: the time of validity."""
    length = flown.instrument.waveform.fft_length
    excess = 2.0 * flown.beams.snr / length * (2.0 * pi * flown.observed_hz() * APERTURE_JITTER_S) ** 2
    range_m, speed_mps = flown.from_beats(flown.noise_variance_hz2(excess))
    late_mps = flown.beams.echoes.closing_acceleration_mps2 * TRIGGER_JITTER_S
    return np.hypot(range_m, flown.speed_mps * TRIGGER_JITTER_S), np.hypot(speed_mps, late_mps)


def clock(flown: Flown) -> Errors:
    """Error of the sample clock: all beats in proportion."""
    return flown.beams.hits.range_m * CLOCK_ERROR, flown.speed_mps * CLOCK_ERROR


def wavelength(flown: Flown) -> Errors:
    """Drift of the wavelength: all speeds in proportion."""
    ratio = WAVELENGTH_DRIFT_M / flown.instrument.waveform.wavelength_m
    return 0.0 * flown.delay_s, flown.speed_mps * ratio


def pointing(flown: Flown) -> Errors:
    """Drift of a beam's direction: R tan(incidence) and the velocity across the beam, times the angle."""
    axis, normal = flown.beams.pointing.true_site, flown.beams.hits.normal_site
    velocity_mps = flown.beams.pointing.sensor_velocity_site_mps
    cosine = np.clip(-(axis * normal).sum(axis=-1), 1e-3, 1.0)
    across_mps = np.sqrt(np.maximum((velocity_mps**2).sum(axis=-1) - flown.speed_mps**2, 0.0))
    tilted_m = flown.beams.hits.range_m * np.sqrt(1.0 / cosine**2 - 1.0)
    # The drift's direction is arbitrary: rms over its azimuth.
    return tilted_m * POINTING_DRIFT_RAD / sqrt(2.0), across_mps * POINTING_DRIFT_RAD / sqrt(2.0)


def travel_time(flown: Flown) -> Errors:
    """The light's travel time: range and speed are R/c old; the Doppler shift has the factor 1 + v/c."""
    old_s, echoes = flown.delay_s / 2.0, flown.beams.echoes
    older_mps = echoes.closing_acceleration_mps2 * old_s
    return echoes.range_rate_mps[..., 0] * old_s, flown.speed_mps**2 / SPEED_OF_LIGHT_MPS - older_mps


def settling_s(flown: Flown) -> float:
    """Time from the beginning of a segment to its record."""
    return flown.instrument.waveform.segment_time_s - flown.instrument.waveform.record_time_s


def weaker_echo(loss: float) -> Callable[[Flown], Errors]:
    """Errors by a loss of the echo's power: the noise grows by the same share."""

    def errors(flown: Flown) -> Errors:
        return flown.from_beats(flown.noise_variance_hz2(np.full((3, *flown.delay_s.shape), loss)))

    return errors


class Source(NamedTuple):
    """A row of the table."""

    name: str
    formula: str
    typical: str
    errors: Callable[[Flown], Errors]
    modelled_by: str = ""
    """Key or fault; empty: not modelled."""


SOURCES = [
    Source(
        "chirp non-linearity, periodic",
        "beat 2A sin(πf_mτ) W(πf_mT_rec)",
        f"rms A {RESIDUAL:g} ST [1], f_m {RIPPLE_HZ / 1e3:g} kHz (assumed)",
        ripple,
        "key `ripple_hz`",
    ),
    Source(
        "chirp non-linearity, random",
        "slope √12 r S, independent in each chirp",
        f"r {RESIDUAL:g} [1], all of it random",
        slope_changes,
        "key `slope_scatter`",
    ),
    Source(
        "leakage between beams",
        "√½ ε g(Δ) bin of each other beam",
        f"ε² -{CROSSTALK_DB:g} dB (assumed)",
        crosstalk,
        "key `leakage_db`",
    ),
    Source(
        "1/f laser noise",
        "3τ √k/T_rec of each beat",
        f"k {FLICKER_HZ2:g} Hz²: {flicker_width_hz(0.01) / 1e3:.2g} kHz of width in 10 ms [2]",
        flicker,
        "key `flicker_hz2`",
    ),
    Source(
        "RIN peak",
        "noise ℛP_LO RIN/(2qΣ CMRR) at its frequency",
        f"{RIN_PEAK_DB_PER_HZ:g} dB/Hz at {RIN_PEAK_HZ / 1e6:g} MHz, ± {RIN_HALF_WIDTH_HZ / 1e6:g} MHz [3]",
        rin_peak,
        "",
    ),
    Source(
        "drift of alignment",
        "R tan θ δ/√2; V⊥ δ/√2",
        f"δ {POINTING_DRIFT_RAD * 1e6:g} µrad: 1 K across aluminium as long as deep",
        pointing,
        "fault `misalignment`",
    ),
    Source(
        "drift of wavelength",
        "v δλ/λ",
        f"δλ {WAVELENGTH_DRIFT_M * 1e12:g} pm: 0.1 nm/K held to 0.01 K (assumed)",
        wavelength,
        "fault `scale`",
    ),
    Source("sample clock", "R δ; v δ", f"δ {CLOCK_ERROR:g} (assumed)", clock, "fault `scale`"),
    Source("light's travel time", "R'R/c; v²/c - aR/c", "exact", travel_time, modelled_by="always computed"),
    Source(
        "sampling and trigger jitter",
        "noise 2K/N (2πgσ)²; v σ_t, a σ_t",
        f"σ {APERTURE_JITTER_S * 1e12:g} ps, σ_t {TRIGGER_JITTER_S * 1e9:g} ns (assumed)",
        jitter,
    ),
    Source(
        "droop of the local oscillator",
        "loss m²/12; none of the frequency",
        f"m {DROOP:g} in a record (assumed)",
        weaker_echo(DROOP**2 / 12.0),
    ),
    Source(
        "polarisation fading",
        "loss of the extinction ratio",
        f"{POLARISATION_LOSS:g}: polarisation-maintaining fibre of 20 dB (assumed)",
        weaker_echo(POLARISATION_LOSS),
    ),
]


def fly(name: str) -> Flown | None:
    """A shipped scenario with the errors of its beams; None for bench patterns and live truth."""
    scenario = load(name)
    if not isinstance(scenario, FlightScenario) or scenario.live is not None:
        return None
    beamlets = scenario.instrument.optics.beamlets
    return Flown(
        name.removesuffix(".yaml"), scenario.instrument, beam_errors(scenario, Flight(scenario), beamlets)
    )


def flown() -> list[Flown]:
    """All shipped flights."""
    return [each for name in sorted(shipped_scenarios()) if (each := fly(name)) is not None]


class Share(NamedTuple):
    """An error on a flight, relative to sigma."""

    of_sigma: float
    error: float
    flight: str


def shares(source: Source, flights: list[Flown]) -> list[tuple[Share, Share]]:
    """Shares of sigma of range and of closing speed on each flight."""
    found = []
    for each in flights:
        with np.errstate(invalid="ignore", divide="ignore"):
            rms = [each.rms(error) for error in source.errors(each)]
        sigma = [each.rms(values) for values in each.beams.sigma]
        found.append(
            (Share(rms[0] / sigma[0], rms[0], each.name), Share(rms[1] / sigma[1], rms[1], each.name))
        )
    return found


def reflection_db(each: Flown) -> float:
    """Line of the window's reflection in a chirp over the strongest echo of a flight."""
    instrument, model = each.instrument, build_receiver(each.instrument)
    beat_bin = model.beat_bin_per_m * REFLECTION_M
    corner_bin = model.response.highpass_bin
    passed = beat_bin**2 / (beat_bin**2 + corner_bin**2)
    line_w = instrument.optics.laser_power_w * 10.0 ** (-RETURN_LOSS_DB / 10.0)
    return 10.0 * log10(line_w * passed / float(np.nanmax(each.beams.echoes.power_w)))


def full_scale_db(each: Flown) -> float:
    """Strongest echo of a flight over the digitiser's full scale; -inf with an ideal digitiser."""
    receiver, optics = each.instrument.receiver, each.instrument.optics
    if receiver.adc is None:
        return -np.inf
    power_w = float(np.nanmax(each.beams.echoes.power_w))
    current_a = 2.0 * receiver.responsivity_a_per_w
    current_a *= sqrt(optics.heterodyne_efficiency * receiver.local_oscillator_power_w * power_w)
    return 20.0 * log10(current_a * receiver.transimpedance_ohm / (0.5 * receiver.adc.full_scale_v))


def parts() -> Iterator[Part]:
    """The table, and two sources that no closed form gives."""
    flights = flown()
    ranked = sorted(((shares(source, flights), source) for source in SOURCES), key=_size, reverse=True)
    yield (
        "source", "error of range; of closing speed", "typical value", "range: share of sigma, error, flight",
        "speed: share of sigma, error, flight", "flights above 5 %", "modelled by",
    )  # fmt: skip
    for each, source in ranked:
        cells = (
            _cell(max(pair[0] for pair in each), 1.0, "m"),
            _cell(max(pair[1] for pair in each), 1e3, "mm/s"),
        )
        above = sum(max(pair).of_sigma > BUILD_ABOVE for pair in each)
        verdict = f"{above} of {len(flights)}" if above else "none"
        modelled_by = source.modelled_by or ("**not yet**" if above else "-")
        yield source.name, source.formula, source.typical, *cells, verdict, modelled_by
    reflected = [reflection_db(each) for each in flights]
    brightest = max(full_scale_db(each) for each in flights)
    guard_s = min(map(settling_s, flights))
    yield (
        f"Back-reflection of {RETURN_LOSS_DB:g} dB [4], {REFLECTION_M:g} m from the local oscillator's splitter: "
        f"a line {min(reflected):.0f} to {max(reflected):.0f} dB above the strongest echo of every flight, behind the "
        "AC coupling: all chirps lock onto it. Modelled by key `back_reflection_db`."
    )
    yield (
        f"Saturation: the strongest echo of any flight is {-brightest:.0f} dB below full scale; on these flights there "
        "is none. It needs a retroreflector, which a fault of kind `reflectance_patch` places; key `adc` models the "
        "clipping. Operational amplifiers recover within 0.2 to "
        f"{SLOWEST_RECOVERY_S * 1e6:.0f} µs [5], and records begin {guard_s * 1e6:.0f} µs after their segments at the "
        f"earliest, which leaves {100 * exp(-guard_s / SLOWEST_RECOVERY_S):.1f} % of the loss of gain at most."
    )


def _size(row: tuple[list[tuple[Share, Share]], Source]) -> float:
    return max(max(pair).of_sigma for pair in row[0])


def _cell(share: Share, scale: float, unit: str) -> str:
    if share.error == 0.0:
        return "0"
    return f"{share.of_sigma:.2g}: {share.error * scale:.2g} {unit}, `{share.flight}`"
