"""Recovery of the amplifier after a clipped record: closed forms, samples, and all levels that receive records."""

from __future__ import annotations

from math import erf, sqrt

import numpy as np
import pytest
from instruments import PLAIN_RECEIVER, echoes, plain
from scipy.integrate import quad

from lidar_emu.errors import InputError
from lidar_emu.fmcw.own_detector_receiver import OwnDetectorReceiver
from lidar_emu.fmcw.receiver import FmcwReceiver, receive
from lidar_emu.fmcw.receiver_constants import build_receiver
from lidar_emu.fmcw.returns import Echoes
from lidar_emu.fmcw.waveform.gain_recovery import RecoveringAmplifier
from lidar_emu.fmcw.waveform.level import measure_echoes
from lidar_emu.fmcw.waveform.own_detector import SegmentSpectrum
from lidar_emu.fmcw.workspace import as_workspace
from lidar_emu.scenario.instrument import Adc, Instrument, Optics, Waveform
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model

SHORT = {"fft_length": 512, "sample_rate_hz": 600e6 / 256}
"""A record as long as the shipped one, of few samples."""

GUARD_S = 300e-6 - 512 / SHORT["sample_rate_hz"]
SPEED_MPS = 0.2003
DOPPLER_HZ = 2.0 * SPEED_MPS / 1.55e-6
SPECULAR = Optics(speckle=False)


def _instrument(adc: Adc, optics: Optics = SPECULAR, **detection: object) -> Instrument:
    receiver = PLAIN_RECEIVER.model_copy(update={"ac_coupling_hz": 10e3, "adc": adc})
    short = plain(SHORT, **({"peak": "hann"} | detection))
    return short.model_copy(update={"optics": optics, "receiver": receiver})


def _full_scale_v(instrument: Instrument, amplitude: float) -> float:
    """Full scale to either side of which a tone of this amplitude, in units of the noise per bin, lies."""
    assert instrument.receiver.adc is not None
    return instrument.receiver.adc.full_scale_v * amplitude / build_receiver(instrument).response.full_scale


@pytest.mark.parametrize("window", ["rect", "hann", "hamming"])
@pytest.mark.parametrize("recovery_s", [1e-7, 13e-6, 2e-4, 1e-2])
def test_the_mean_in_a_record_is_the_windows(window: str, recovery_s: float) -> None:
    side = {"rect": 0.0, "hann": 0.5, "hamming": 0.46}[window]
    record_s = 300e-6 - GUARD_S
    share, _ = quad(
        lambda x: (1.0 - side - side * np.cos(2.0 * np.pi * x)) * np.exp(-x * record_s / recovery_s),
        0.0,
        1.0,
        epsabs=0.0,
        points=[min(1.0, 5.0 * recovery_s / record_s)],
    )
    recovery = build_receiver(_instrument(Adc(recovery_time_s=recovery_s), window=window)).gain_recovery
    assert recovery.mean_in_record == pytest.approx(share / (1.0 - side), rel=1e-6, abs=1e-15)
    assert recovery.left_by_guard == pytest.approx(np.exp(-GUARD_S / recovery_s), rel=1e-12)
    assert recovery.left_by_guard * recovery.left_by_record == pytest.approx(
        np.exp(-300e-6 / recovery_s), rel=1e-9
    )


@pytest.mark.parametrize("recovery_s", [5e-324, 1e-300, 1e-12, 1e9])
def test_shares_of_extreme_times_are_shares(recovery_s: float) -> None:
    shares = np.array(build_receiver(_instrument(Adc(recovery_time_s=recovery_s))).gain_recovery)
    assert ((shares >= 0.0) & (shares <= 1.0)).all()
    assert shares[0] == pytest.approx(0.0 if recovery_s < 1.0 else 1.0)


def test_samples_lose_what_a_clipped_sine_loses() -> None:
    """A sine of A times full scale keeps (2/π)(asin(1/A) + sqrt(1 - 1/A²)/A) of its amplitude."""
    waveform = Waveform(**SHORT)
    amplifier = RecoveringAmplifier(waveform, 2e-4, full_scale=2.0, records=2)
    over = np.array([[3.0], [0.9]])
    sine = over * np.sin(2.0 * np.pi * 37.3 * np.arange(512) / 512)
    np.testing.assert_array_equal(amplifier.amplify(sine), sine)
    lost = 1.0 - 2.0 / np.pi * (np.arcsin(1 / 3) + np.sqrt(1.0 - 1 / 9) / 3)
    # Nothing but the rest of the first record's loss is left in the third.
    for begun_s in (GUARD_S, GUARD_S + 300e-6):
        quiet = amplifier.amplify(np.full((2, 512), 1e-3)) / 1e-3
        left = np.exp(-(begun_s + np.arange(512) / SHORT["sample_rate_hz"]) / 2e-4)
        np.testing.assert_allclose(quiet[0], 1.0 - lost * left, atol=2e-3)
        np.testing.assert_array_equal(quiet[1], 1.0)
    dark = RecoveringAmplifier(waveform, 2e-4, full_scale=2.0)
    assert (dark.amplify(np.zeros((1, 512))) == 0.0).all()
    assert (dark.amplify(np.ones((1, 512))) == 1.0).all()


class _Peaks:
    """A detector that keeps the power of the Doppler line of each constant segment, and finds nothing."""

    def __init__(self) -> None:
        self.power: list[float] = []

    def __call__(self, spectrum: SegmentSpectrum) -> tuple[()]:
        if spectrum.segment == "constant":
            near = np.abs(spectrum.frequency_hz - DOPPLER_HZ) < 1e4
            self.power.append(float(spectrum.power[near].max()))
        return ()


def _constant_amplitude(adc: Adc, level: str) -> float:
    """Amplitude of the constant segment's line beside a back-reflection that overdrives the chirps alone."""
    optics = SPECULAR.model_copy(update={"back_reflection_db": -80.0, "back_reflection_range_m": 3.0})
    instrument = _instrument(adc, optics)
    model, beams, shot = (
        build_receiver(instrument),
        echoes(np.full((20, 1, 1), 30.0), SPEED_MPS, 3e-12),
        np.arange(20),
    )
    peaks = _Peaks()
    if level == "spectral":
        OwnDetectorReceiver(model, 1, instrument, peaks)(beams, shot)
    else:
        measure_echoes(instrument, model, beams, shot, 2, peaks)
    return float(np.sqrt(np.mean(peaks.power)))


@pytest.mark.parametrize("recovery_s", [5e-5, 2e-4, 2e-3])
def test_a_record_after_a_clipped_one_has_the_gain_of_its_samples(recovery_s: float) -> None:
    """Samples have a gain that changes in time, and lose what a clipped sine loses."""
    optics = SPECULAR.model_copy(update={"back_reflection_db": -80.0})
    wide = _instrument(Adc(effective_bits=16.0), optics)
    volts = _full_scale_v(wide, np.sqrt(build_receiver(wide).back_reflection.snr) / 10.0)
    gains = []
    for level in ("spectral", "waveform"):
        at_once, slowly = (
            _constant_amplitude(Adc(effective_bits=16.0, full_scale_v=volts, recovery_time_s=each), level)
            for each in (0.0, recovery_s)
        )
        gains.append(slowly / at_once)
    recovery = build_receiver(_instrument(Adc(recovery_time_s=recovery_s))).gain_recovery
    # A sine of ten times full scale loses 0.87 of its amplitude.
    assert gains[1] == pytest.approx(1.0 - 0.87 * recovery.left_by_guard * recovery.mean_in_record, abs=0.015)
    assert gains[0] == pytest.approx(gains[1], abs=0.015)
    assert gains[1] < 0.99


def test_losses_of_all_looks_follow_one_another() -> None:
    """An echo of the same power in all records, whose loss is a fixed function of the gain, in two looks."""
    instrument = _instrument(Adc(full_scale_v=1e-3, recovery_time_s=2e-4), looks=2)
    model = build_receiver(instrument)
    snr = 4.0 * model.response.full_scale**2
    beams = echoes(30.0, SPEED_MPS, snr / model.snr_per_w)
    receiver = FmcwReceiver(model, 1)
    receiver(beams, np.arange(1))
    found = as_workspace.py_func(receiver._work).amplifier_gain
    ratio = np.sqrt(model.response.mean_noise * 512 / 4.0 + 0.5 * snr) / model.response.full_scale
    expected, lost, recovery = np.zeros(3), 0.0, model.gain_recovery
    for record in range(6):
        begun = lost * np.exp(-GUARD_S / 2e-4)
        gain = 1.0 - begun * recovery.mean_in_record
        expected[record % 3] += gain / 2.0
        lost = max(1.0 - erf(1.0 / (ratio * gain * sqrt(2.0))), begun * np.exp(-(300e-6 - GUARD_S) / 2e-4))
    # The high-pass takes 0.1 % of the chirps' tone.
    np.testing.assert_allclose(found, expected, rtol=3e-3)
    assert found[0] > found[1] + 0.05


def _fading(shots: int, power_w: float) -> Echoes:
    """Echoes whose speckle is another in each record."""
    rng = np.random.default_rng(5)
    place = rng.uniform(-1e4, 1e4, (shots, 1, 2))
    return echoes(np.full((shots, 1, 1), 30.0), SPEED_MPS, power_w, place=place, drift_per_s=(2e4, 0.0))


def test_it_is_left_out_exactly_where_nothing_exceeds_full_scale() -> None:
    beams = _fading(50, 1e-12)
    at_once, slowly = (
        receive(
            build_receiver(_instrument(Adc(recovery_time_s=each), Optics())),
            beams,
            np.arange(50),
            1,
        )
        for each in (0.0, 1e-3)
    )
    assert at_once.range_valid.any()
    assert all(
        np.array_equal(getattr(at_once, name), getattr(slowly, name), equal_nan=True)
        for name in ("range_m", "closing_speed_mps", "snr_db", "sigma_range_m", "returns")
    )


@pytest.mark.slow
def test_levels_agree_on_fading_echoes_beyond_full_scale() -> None:
    """Echoes of three times full scale, whose loss of gain remains in the next records: the digitiser clips less of
    them and adds less noise. Level `waveform` refers its SNR to the noise without clipping."""
    shots, snr = 400, 10.0**3.2
    wide = _instrument(Adc(), Optics())
    volts = _full_scale_v(wide, np.sqrt(snr) / 3.0)
    snr_db, scatter = [], []
    for recovery_s in (0.0, 2e-3):
        adc = Adc(full_scale_v=volts, recovery_time_s=recovery_s)
        instrument = _instrument(adc, Optics(), window="hann")
        spectral = build_receiver(instrument)
        beams, shot = _fading(shots, snr / spectral.snr_per_w), np.arange(shots)
        levels = (
            receive(spectral, beams, shot, 1),
            measure_echoes(instrument, spectral, beams, shot, 2),
        )
        assert all(each.range_valid.mean() > 0.98 for each in levels)
        snr_db.append([np.nanmedian(each.snr_db) for each in levels])
        scatter.append([_deviation(each.closing_speed_mps - SPEED_MPS) for each in levels])
    gained_db = np.subtract(snr_db[1], snr_db[0])
    assert gained_db[0] > 1.0
    assert -1.5 < gained_db[1] < -0.3
    # Three Monte Carlo errors of a ratio of robust deviations, 0.17, around a difference of 10 % without recovery.
    np.testing.assert_allclose(scatter[1], scatter[1][0], rtol=0.27)


def _deviation(errors: np.ndarray) -> float:
    return float(1.4826 * np.nanmedian(np.abs(errors - np.nanmedian(errors))))


KEY = "instrument.receiver.adc.recovery_time_s"


@pytest.mark.parametrize("value", [".nan", "-1e-6", ".inf", "1e300", "0.0072"])
def test_times_that_outlast_a_shot_are_refused(value: str) -> None:
    with pytest.raises(InputError, match="recovery_time_s"):
        load("descent.yaml", {KEY: value})


@pytest.mark.parametrize("value", ["0", "1e-300", "13e-6", "0.007"])
def test_the_plan_states_what_is_left(value: str) -> None:
    scenario = load("descent.yaml", {KEY: value, "duration_s": "0.5"})
    (row,) = (
        each for each in build_model(scenario).plan.decisions if each.stage == "recovery of the amplifier"
    )
    expected = {
        "0": (False, "exact", "recovery_time_s is 0"),
        "1e-300": (False, "exact", "nothing of a loss of gain is left for the next record"),
        "13e-6": (True, "0.19 % of a loss", "0.19 % of a loss of gain"),
        "0.007": (True, "98 % of a loss", "99 % of a loss of gain"),
    }
    computed, bound, reason = expected[value]
    assert row.computed == computed
    assert bound in row.bound
    assert reason in row.reason


def test_a_tiny_full_scale_leaves_numbers() -> None:
    for full_scale_v in (1e-9, 1e-6):
        adc = Adc(full_scale_v=full_scale_v, recovery_time_s=1e-2)
        returns = receive(build_receiver(_instrument(adc)), echoes(30.0, SPEED_MPS, 1.0), np.arange(1), 1)
        assert np.isfinite(returns.snr_db).all()
