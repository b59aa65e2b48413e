"""The spectral level against every sample, and against closed forms.

Without noise, of a tone at 2 km up to 100 m/s, frequencies agree to 1e-6 bin and peak powers to 1e-5 dB: migration is
smear to that order. Of speckle from a surface 0.4 m deep, to 3e-5 bin. Where a point of the ground accelerates by
100 m/s², 6.2 bins in a record, to 3e-4 bin and 2e-4 dB: the filter's taps end. With noise, distributions agree as
far as 1e5 draws can tell.

The laser's line, whose taps are drawn as Gaussian numbers, scatters the frequency by 5 % too little where the phase
drifts by 0.5 rad within the delay (3 kHz at 2 km), and loses 0.55 dB too much where it drifts by 1.6 rad (30 kHz).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from beamlet_samples import (
    ScattererPatches,
    WaveformMeasurement,
    measure_echoes,
    measure_waveform,
    scatterer_patches,
)
from scipy.stats import ks_2samp

import lidar_emu
from benchmarks.echo_field import echo_field
from lidar_emu.receiver.probability import (
    detection_probability,
    false_lock_probability,
    shared_fade_probability,
)
from lidar_emu.receiver.receiver import receive
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import TRAVEL, Echoes, Reason, Returns
from lidar_emu.reference.analog_receiver import AnalogResponse, noise_level
from lidar_emu.scenario.instrument import (
    SPEED_OF_LIGHT_MPS,
    Adc,
    Detection,
    Instrument,
    Optics,
    Receiver,
    Waveform,
)
from lidar_emu.scenario.load import load

pytestmark = pytest.mark.slow

BRIGHT_OSCILLATOR = Receiver(
    local_oscillator_power_w=1e6,
    dark_current_a=0.0,
    relative_intensity_noise_db_per_hz=None,
    bandwidth_hz=None,
    ac_coupling_hz=0.0,
    adc=None,
)
"""So bright that the echo's own shot noise is nothing beside it, whatever the echo."""

SHORT = {"fft_length": 512, "sample_rate_hz": 600e6 / 256, "linewidth_hz": 0.0}
"""The record of the defaults, with few samples."""

RANGE_M, SPEED_MPS = 30.013, 0.2003
"""Within the band of short records: beats of +31, 56 and 143 bins."""

FINE = {"peak": "hann", "combine": "least_squares"}


class Case(NamedTuple):
    """An instrument, and a surface at one place in all of many shots."""

    instrument: Instrument
    model: ReceiverModel
    range_m: np.ndarray
    speed_mps: np.ndarray
    snr: float

    def echoes(self, shots: int, acceleration_mps2: float = 0.0) -> Echoes:
        """Of independent speckle."""
        count = self.range_m.size
        each = np.ones((shots, 1, count))
        still = np.zeros((shots, 1))
        place = np.stack([10.3 * np.arange(shots)[:, None], still + 0.6], axis=-1)
        power_w = each * self.snr / self.model.snr_per_w / count
        return Echoes(
            each * self.range_m,
            each * self.speed_mps,
            power_w,
            0.0 * each,
            still + acceleration_mps2,
            still,
            still,
            still,
            place,
            0.0 * place,
            still == 0.0,
            still != 0.0,
        )

    def spectral(self, shots: int, seed: int = 1, acceleration_mps2: float = 0.0) -> Returns:
        return receive(self.model, self.echoes(shots, acceleration_mps2), np.arange(shots), seed)

    def waveform(
        self,
        shots: int,
        seed: int = 2,
        field_seed: int | None = None,
        noise_share: float = 1.0,
        acceleration_mps2: float = 0.0,
    ) -> WaveformMeasurement:
        """All shots at once; a share of 0 leaves the noise out."""
        receiver = self.instrument.receiver
        response = AnalogResponse.of(receiver)
        echoes = self.echoes(shots)
        field = echo_field(self.model, echoes, np.arange(shots), seed if field_seed is None else field_seed)
        return measure_waveform(
            self.instrument.waveform,
            self.instrument.detection,
            ScattererPatches(self.range_m, self.speed_mps, field.at_centre()[:, 0], 0.0, acceleration_mps2),
            response=response,
            rng=np.random.default_rng(seed),
            noise_share=noise_share,
            noise_level=noise_level(self.instrument.waveform, response),
        )


def _case(
    snr_db: float,
    waveform: dict[str, Any] | None = None,
    detection: dict[str, Any] | None = None,
    receiver: dict[str, Any] | None = None,
    beamlets: int = 1,
    speckle: bool = False,
    place: tuple[float, float] = (RANGE_M, SPEED_MPS),
    depth_m: float = 0.02,
) -> Case:
    instrument = Instrument(
        waveform=Waveform(**(SHORT if waveform is None else waveform)),
        optics=Optics(speckle=speckle),
        receiver=Receiver(**(dict(BRIGHT_OSCILLATOR) | (receiver or {}))),
        detection=Detection(**(FINE if detection is None else detection)),
    )
    across = np.linspace(-1.0, 1.0, beamlets) if beamlets > 1 else np.zeros(1)
    # As of a slope: the farther, the faster.
    return Case(
        instrument,
        build_receiver(instrument, left_out_share=0.0),
        place[0] + depth_m * across,
        place[1] + 0.02 * depth_m * across,
        10 ** (snr_db / 10),
    )


LONG = {"linewidth_hz": 0.0}


@pytest.mark.parametrize(
    "poles", [{}, {"bandwidth_hz": 300e6, "ac_coupling_hz": 50e3}], ids=["flat", "poles"]
)
@pytest.mark.parametrize(
    ("speed_mps", "acceleration_mps2", "bins", "decibels"),
    [
        (1.0, 0.0, 2e-6, 5e-6),  # rounding to single precision
        (100.0, 0.0, 2e-6, 5e-6),
        (1.0, 10.0, 2e-5, 2e-5),
        (100.0, 100.0, 5e-5, 1.2e-4),
    ],
)
@pytest.mark.parametrize("beamlets", [1, 7])
def test_without_noise(
    poles: dict[str, float],
    speed_mps: float,
    acceleration_mps2: float,
    bins: float,
    decibels: float,
    beamlets: int,
) -> None:
    detection = FINE | {"window": "hann"}
    place = 2000.0, speed_mps
    case = _case(130.0, LONG, detection, poles, beamlets, True, place, depth_m=0.2)
    spectral = case.spectral(1, 1, acceleration_mps2)
    exact = case.waveform(1, 2, 1, 0.0, acceleration_mps2)
    # Of several beamlets each is smeared and filtered like the first, and a fade makes more of what is left.
    looser = 1 if beamlets == 1 else 50
    apart_hz = spectral.segment_peak_hz[0] - exact.segment_peak_hz
    assert abs(apart_hz).max() < looser * bins * case.instrument.waveform.bin_width_hz
    assert abs(spectral.snr_db[0] - exact.snr_db) < looser * decibels


@pytest.mark.parametrize("way", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("beamlets", [1, 7])
def test_speckle_that_changes_within_the_record(way: float, beamlets: int) -> None:
    """Without noise: three, five and nine tones for each beamlet."""
    case = _case(130.0, LONG, FINE | {"window": "hann"}, {}, beamlets, True, (2000.0, 1.0), 0.2)
    echoes = case.echoes(6)
    echoes.speckle_motion[..., TRAVEL] = way / case.model.record_time_s
    spectral = receive(case.model, echoes, np.arange(6), 1)
    field = echo_field(case.model, echoes, np.arange(6), 1)
    waveform, detection = case.instrument.waveform, case.instrument.detection
    apart_bin = []
    for s in range(6):
        exact = measure_waveform(waveform, detection, scatterer_patches(waveform, echoes, field, s, 0))
        apart_hz = spectral.segment_peak_hz[s, 0] - exact.segment_peak_hz[0]
        apart_bin.append(abs(apart_hz).max() / waveform.bin_width_hz)
        assert abs(spectral.snr_db[s, 0] - exact.snr_db[0]) < 1e-3
    # Migration within the record is smear to first order, and a fade makes more of the rest.
    assert max(apart_bin) < 2e-4
    assert np.median(apart_bin) < (1e-5 if beamlets == 1 else 5e-5)
    steady = receive(case.model, case.echoes(6), np.arange(6), 1)
    assert np.median(abs(spectral.segment_peak_hz - steady.segment_peak_hz)) > 0.02 * waveform.bin_width_hz


def test_smear_and_migration_are_seen() -> None:
    """What the agreement without noise is worth: left out, each would be a hundred times its bound."""
    still, moving, smeared = (
        _case(130.0, LONG, None, {}, 1, False, (2000.0, speed_mps)).waveform(1, 2, 1, 0.0, acceleration_mps2)
        for speed_mps, acceleration_mps2 in ((1e-3, 0.0), (100.0, 0.0), (1e-3, 100.0))
    )
    still_power, moving_power, smeared_power = (m.targets[2].power[0, 0] for m in (still, moving, smeared))
    assert abs(10 * np.log10(moving_power / still_power)) > 1e-3
    assert 10 * np.log10(smeared_power / still_power) < -2.0


def _scatter_apart(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Difference of the logarithms of two variances, in its standard deviations."""
    logs, errors = [], []
    for column in (ours, theirs):
        square = np.square(column - column.mean())
        logs.append(np.log(square.mean()))
        errors.append(square.var() / square.mean() ** 2 / square.size)
    return float(abs(logs[0] - logs[1]) / np.sqrt(sum(errors)))


def _finite(column: np.ndarray) -> np.ndarray:
    return np.ravel(column)[np.isfinite(np.ravel(column))]


def _least_p(spectral: Returns, exact: WaveformMeasurement) -> float:
    """Of Kolmogorov and Smirnov's test, over power, errors of range and speed, and residual."""
    names = "snr_db", "range_m", "closing_speed_mps", "residual_mps", "sigma_range_m"
    return min(
        float(ks_2samp(_finite(getattr(spectral, name)), _finite(getattr(exact, name))).pvalue)
        for name in names
    )


@pytest.mark.parametrize(
    ("snr_db", "window", "beamlets", "receiver"),
    [
        pytest.param(15.0, "hamming", 1, {}, id="near the threshold"),
        pytest.param(20.0, "hann", 1, {}, id="hann"),
        pytest.param(20.0, "rect", 1, {}, id="no window"),
        pytest.param(25.0, "hamming", 7, {}, id="speckle"),
        pytest.param(
            25.0, "hamming", 7, {"bandwidth_hz": 0.7e6, "ac_coupling_hz": 50e3}, id="speckle and poles"
        ),
    ],
)
def test_distributions_with_noise(
    snr_db: float, window: str, beamlets: int, receiver: dict[str, float]
) -> None:
    case = _case(snr_db, None, FINE | {"window": window}, receiver, beamlets, speckle=beamlets > 1)
    spectral, exact = case.spectral(60_000, seed=7), case.waveform(10_000)
    assert _least_p(spectral, exact) > 1e-3
    rates = (spectral.reason == Reason.VALID).mean(), exact.range_valid.mean()
    assert abs(rates[0] - rates[1]) < 4 * np.sqrt(rates[1] * (1 - rates[1]) / 10_000 + 1e-8)


def test_scatter_of_frequencies_shows_two_percent_of_noise() -> None:
    case = _case(25.0)
    bin_hz = case.instrument.waveform.bin_width_hz

    def errors(peaks_hz: np.ndarray) -> np.ndarray:
        """Pooled, in units of each segment's own scatter in the spectral level."""
        return np.ravel((peaks_hz - mean) / scatter)

    spectral_hz = case.spectral(200_000, seed=11).segment_peak_hz[:, 0]
    mean, scatter = spectral_hz.mean(axis=0), spectral_hz.std(axis=0)
    assert (scatter < 0.05 * bin_hz).all()
    same, louder = (case.waveform(25_000, 22, noise_share=share).segment_peak_hz for share in (1.0, 1.02))
    assert _scatter_apart(errors(spectral_hz), errors(same)) < 2.0
    assert _scatter_apart(errors(spectral_hz), errors(louder)) > 2.5


@pytest.mark.parametrize("receiver", [{}, {"bandwidth_hz": 0.7e6}], ids=["flat", "low-pass"])
def test_peaks_of_noise_alone_show_two_percent_of_noise(receiver: dict[str, float]) -> None:
    detection = {"window": "rect", "false_alarm_probability": 0.5}
    case = _case(-300.0, None, detection, receiver)
    dark = case.echoes(60_000)
    dark = dark._replace(power_w=np.zeros_like(dark.power_w))
    spectral = receive(case.model, dark, np.arange(60_000), 1)
    same, louder = (case.waveform(6000, noise_share=share) for share in (1.0, 1.02))
    # Nothing detected is no power.
    powers = [np.nan_to_num(np.ravel(r.snr_db), nan=-np.inf) for r in (spectral, same, louder)]
    assert ks_2samp(powers[0], powers[1]).pvalue > 1e-2
    assert ks_2samp(powers[0], powers[2]).pvalue < 1e-4


def test_strangers_are_distinguished() -> None:
    """The comparison of distributions fails for 0.1 dB of echo."""
    spectral, exact = _case(20.1).spectral(60_000), _case(20.0).waveform(10_000)
    assert _least_p(spectral, exact) < 1e-6


def _on_bins(snr_db: float, probability: float, speckle: bool) -> Case:
    """The default records, and tones in the middle of bins 2000, 3000 and 4000."""
    detection = {"window": "rect", "false_alarm_probability": probability}
    waveform = Waveform(**LONG)
    range_m = 3000 * SPEED_OF_LIGHT_MPS * waveform.bin_width_hz / (2 * waveform.chirp_slope_hz_per_s)
    place = range_m, 1000 * waveform.wavelength_m * waveform.bin_width_hz / 2
    return _case(snr_db, LONG, detection, {}, 1, speckle, place)


@pytest.mark.parametrize(("snr_db", "minus_log_pfa"), [(15.0, 30.0), (20.0, 100.0), (30.0, 690.0)])
@pytest.mark.parametrize("speckle", [False, True], ids=["steady", "speckle"])
def test_detection_probability(snr_db: float, minus_log_pfa: float, speckle: bool) -> None:
    shots = 50_000
    case = _on_bins(snr_db, 65536 * np.exp(-minus_log_pfa), speckle)
    segments = case.spectral(shots).segments[:, 0]
    expected = float(detection_probability("swerling_2" if speckle else "steady", case.snr, minus_log_pfa))
    every = expected**3
    if speckle:
        every = float(shared_fade_probability(lambda p: p**3, case.snr, minus_log_pfa))
    for rate, wanted in ((((segments & 2) > 0).mean(), expected), ((segments == 7).mean(), every)):
        assert abs(rate - wanted) < 4 * np.sqrt(wanted * (1 - wanted) / shots) + 1e-9
    assert 0.2 < expected < 0.8 or snr_db == 30.0


@pytest.mark.parametrize("snr_db", [10.0, 11.0, 12.0, 13.0, 14.0])
@pytest.mark.parametrize("speckle", [False, True], ids=["steady", "speckle"])
def test_false_lock_rate(snr_db: float, speckle: bool) -> None:
    shots = 30_000
    case = _on_bins(snr_db, 1e-3, speckle)
    constant_hz = case.spectral(shots).segment_peak_hz[:, 0, 1]
    peak_bin = np.rint(_finite(constant_hz) / case.instrument.waveform.bin_width_hz)
    rate = np.sum(peak_bin != 1000) / shots
    expected = float(
        false_lock_probability("swerling_2" if speckle else "steady", case.snr, np.log(65536 / 1e-3), 65534)
    )
    assert expected > 1e-4
    assert abs(rate - expected) < 4 * np.sqrt(expected / shots)


@pytest.mark.parametrize("snr_db", [9.0, 11.0])
def test_false_lock_rate_of_the_waveform(snr_db: float) -> None:
    """In 255 bins, without a threshold to speak of."""
    shots = 10_000
    waveform = Waveform(**SHORT)
    place = RANGE_M, 56 * waveform.wavelength_m * waveform.bin_width_hz / 2
    detection = {"window": "rect", "false_alarm_probability": 0.5}
    exact = _case(snr_db, None, detection, {}, 1, False, place).waveform(shots)
    rate = np.sum(_finite(exact.targets[1].frequency_bin[:, 0]) != 56) / shots
    expected = float(false_lock_probability("steady", 10 ** (snr_db / 10), np.log(256 / 0.5), 254))
    assert abs(rate - expected) < 4 * np.sqrt(expected / shots)


@pytest.mark.parametrize(
    ("linewidth_hz", "scatter", "decibels"), [(300.0, 0.05, 0.005), (3e3, 0.1, 0.03), (30e3, 0.1, 0.7)]
)
def test_line_of_the_laser(linewidth_hz: float, scatter: float, decibels: float) -> None:
    """At 2 km, with a slope that keeps the beats of short records in band: the delay is what counts."""
    shots = 2000
    line = {"fft_length": 1024, "sample_rate_hz": 600e6 / 128, "chirp_slope_hz_per_s": 2e12 / 128}
    case = _case(60.0, line | {"linewidth_hz": linewidth_hz}, place=(2000.0, 0.3))
    spectral, exact = case.spectral(8000), case.waveform(shots)
    assert abs(np.mean(_finite(spectral.snr_db)) - np.mean(_finite(exact.snr_db))) < decibels
    ratio = spectral.segment_peak_hz[:, 0].std(axis=0) / exact.segment_peak_hz.std(axis=0)
    assert abs(ratio - 1).max() < scatter
    # The loss of power in a bin, exp(-2πΔντ), is what makes the line matter.
    lost = _case(60.0, line | {"linewidth_hz": 0.0}, place=(2000.0, 0.3)).waveform(1).snr_db[0]
    lost -= 10 * np.log10(np.mean(10 ** (_finite(exact.snr_db) / 10)))
    delay_s = 2 * 2000.0 / SPEED_OF_LIGHT_MPS
    expected = 10 * np.log10(np.e) * 2 * np.pi * linewidth_hz * delay_s
    assert lost < expected + 0.02
    assert lost > 0.8 * expected or linewidth_hz > 1e4


def test_whole_instrument_reports_alike() -> None:
    """The default receiver with its poles, digitiser and line: every field of a beam of 19 beamlets."""
    waveform = {"fft_length": 4096, "sample_rate_hz": 600e6 / 32, "chirp_slope_hz_per_s": 2e12 / 32}
    receiver = dict(Receiver()) | {"bandwidth_hz": 300e6 / 32, "adc": Adc(effective_bits=10.0)}
    case = _case(30.0, waveform, None, receiver, 19, True, (500.0, 2.0))
    one = case.echoes(40)
    shot = np.arange(40)
    spectral = receive(case.model, one, shot, 9)
    exact = measure_echoes(case.instrument, case.model, one, shot, 9)
    both = (spectral.range_valid & exact.range_valid)[:, 0]
    assert both.mean() > 0.8
    assert (spectral.segments == exact.segments).mean() > 0.75
    # The same speckle, and other noise: six standard deviations of both.
    for value, sigma in (("range_m", "sigma_range_m"), ("closing_speed_mps", "sigma_speed_mps")):
        apart = getattr(spectral, value) - getattr(exact, value)
        expected = np.hypot(getattr(spectral, sigma), getattr(exact, sigma))
        assert np.median(abs(apart[both] / expected[both])) < 1.2
    # Each sigma follows from the noise of its own three peaks.
    grown = spectral.sigma_range_m[both] / exact.sigma_range_m[both]
    assert 0.75 < np.median(grown) < 1.33
    assert abs(spectral.snr_db[both] - exact.snr_db[both]).mean() < 0.5
    assert np.isfinite(exact.segment_peak_hz[both]).all()
    assert (exact.sign_resolved[both] == spectral.sign_resolved[both]).mean() > 0.9


@pytest.mark.slow
@pytest.mark.parametrize(("laser_power_w", "full_scale_v"), [("1e3", "0.01"), ("1e6", "0.1"), ("1e9", "1")])
def test_the_noise_ratio_of_clipped_records(laser_power_w: str, full_scale_v: str) -> None:
    """It is over the noise without clipping; 1.05 dB are the line's, which `spectral` takes for a Gaussian record's."""
    keys = {
        "site": "flat",
        "duration_s": "0.5",
        "trajectory": "{kind: profile, waypoints: [{altitude_m: 201, speed_mps: 2}, {altitude_m: 200, speed_mps: 2}]}",
        "timing.rate_hz": "50",
        "instrument.waveform": "{fft_length: 4096, sample_rate_hz: 18.75e6, linewidth_hz: 0}",
        "instrument.receiver.adc.full_scale_v": full_scale_v,
        "instrument.optics.laser_power_w": laser_power_w,
    }
    full_rate = {"level": "reference", "reference_samples": "full_rate"}
    ratios_db = [
        lidar_emu.simulate(load("descent", keys | level), seed=1).snr_db for level in ({}, full_rate)
    ]
    assert np.median(ratios_db[0]) + 1.05 == pytest.approx(np.median(ratios_db[1]), abs=1.0)
