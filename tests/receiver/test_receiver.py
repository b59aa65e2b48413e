"""The receiver as a whole: published spot values, reasons, chance, and inputs at their extremes."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from instruments import PLAIN, beats_hz, echoes, plain
from scipy.stats import chisquare, ncx2

from lidar_emu.receiver.receiver import receive
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import Echoes, Reason, Returns
from lidar_emu.scenario.instrument import Detection, Instrument

DEFAULT = build_receiver(PLAIN)
JOINT = build_receiver(plain(combine="least_squares", peak="hann"))
DF_HZ = 600e6 / 2**17


def _receive(beams: Echoes, model: ReceiverModel = DEFAULT, seed: int = 1) -> Returns:
    return receive(model, beams, np.arange(len(beams.fired)), seed)


# Descents over flat ground, corner beams: range, closing speed, F+ and F- in MHz, highest bins.
@pytest.mark.parametrize(
    ("range_m", "speed_mps", "up_mhz", "down_mhz", "bins"),
    [
        (2164.784, 92.3880, 90.3265, 148.0940, (19732, 26042, 32352)),
        (541.196, 29.5641, 30.9263, 45.3682, (6756, 8333, 9911)),
        (504.314, 29.7433, 31.6497, 45.1074, (6914, 8384, 9854)),
        (2164.784, 84.4623, 80.10, 137.87, (17498, 23808, 30118)),
        (2164.784, 46.1940, 30.72, 88.49, (6711, 13021, 19331)),
    ],
)
def test_spectra_of_the_published_descents(
    range_m: float, speed_mps: float, up_mhz: float, down_mhz: float, bins: tuple[int, int, int]
) -> None:
    returns = _receive(echoes(range_m, speed_mps))
    peaks_hz = returns.segment_peak_hz[0, 0]
    np.testing.assert_array_equal(np.rint(peaks_hz / DF_HZ), bins)
    assert peaks_hz[0] == pytest.approx(up_mhz * 1e6, abs=DF_HZ + 5e3)
    assert peaks_hz[2] == pytest.approx(down_mhz * 1e6, abs=DF_HZ + 5e3)
    assert returns.reason[0, 0] == Reason.VALID
    assert returns.segments[0, 0] == 7
    assert returns.range_m[0, 0] == pytest.approx(range_m, abs=0.3431)
    assert returns.closing_speed_mps[0, 0] == pytest.approx(speed_mps, abs=0.00178 + 5e-5)


def test_reasons() -> None:
    nan = np.nan
    beams = echoes(
        [1000, 1000, nan, 1000, 1000, 12_100, 12_400, 1000, -1.0, 0.0, np.inf, 1000],
        [20, 20, 20, 20, 20, 20, 20, 20, 20, 20, 20, nan],
        [1e-11, 1e-11, 0, 0, 1e-15, 1e-11, 1e-11, 1e-11, 1e-11, 1e-11, 1e-11, 1e-11],
    )
    beams.fired[0, 1] = False
    beams.inside[0, 7] = True
    returns = _receive(beams)
    expected = [
        Reason.VALID,
        Reason.NOT_FIRED,
        Reason.NO_SURFACE,
        Reason.BELOW_THRESHOLD,
        Reason.BELOW_THRESHOLD,
        Reason.BEYOND_RANGE,  # measured, but beyond the maximum
        Reason.BEYOND_RANGE,  # past the record's edge: heard for most of the record
        Reason.INSIDE_GROUND,
        Reason.INSIDE_GROUND,
        Reason.INSIDE_GROUND,
        Reason.BEYOND_RANGE,
        Reason.BELOW_THRESHOLD,
    ]
    assert returns.reason[0].tolist() == expected
    assert returns.segments[0, 5] == 7
    assert returns.segments[0, 6] == 7
    assert returns.segments[0, 10] == 0
    assert returns.range_valid[0].tolist() == [r == Reason.VALID for r in expected]
    _assert_consistent(returns, DEFAULT.maximum_range_m)


def test_two_surfaces_are_two_returns() -> None:
    shape = (1, 1, 2)
    range_m = np.array([1000.0, 1040.0]).reshape(shape)
    power_w = np.array([4e-12, 2e-12]).reshape(shape)
    # Different speeds too: the constant segment has to tell the surfaces apart.
    speed_mps = np.array([20.0, 20.5]).reshape(shape)
    returns = _receive(echoes(range_m, speed_mps, power_w), JOINT)
    assert returns.returns[0, 0] == 2
    assert returns.range_m[0, 0] == pytest.approx(1000, abs=0.05)
    assert returns.second_range_m[0, 0] == pytest.approx(1040, abs=0.05)
    alone = _receive(echoes(1000.0, 20.0), JOINT)
    assert alone.returns[0, 0] == 1
    assert np.isnan(alone.second_range_m[0, 0])


def test_snr_is_the_number_of_photons_detected() -> None:
    """Tones on their bins in all segments: the mean over shots is K and the noise."""
    shots = 3000
    bin_mps = 1550e-9 * DF_HZ / 2
    bin_m = 299_792_458.0 * DF_HZ / (2 * 2e12)
    shape = (shots, 1, 1)
    for power_w in (1e-12, 4e-12):
        beams = echoes(np.full(shape, 3000 * bin_m), np.full(shape, 5000 * bin_mps), power_w)
        snr = 10 ** (_receive(beams).snr_db / 10)
        photons = 531.65 * power_w / 1e-12
        # On the bin the Hamming window adds its noise bandwidth, 0.3974 / 0.54², to the mean.
        assert snr.mean() == pytest.approx(photons + 1.36, rel=0.005)


@pytest.mark.parametrize("share", [0.1, 1.0, 10.0])
def test_a_strong_echo_adds_its_own_shot_noise(share: float) -> None:
    """The photocurrent's shot noise is 2 q R (P_LO + P): it counts where the echo is as strong as the oscillator."""
    receiver, charge_c, boltzmann_j_per_k = PLAIN.receiver, 1.602176634e-19, 1.380649e-23
    bin_mps, bin_m = 1550e-9 * DF_HZ / 2, 299_792_458.0 * DF_HZ / (2 * 2e12)
    power_w = share * receiver.local_oscillator_power_w
    oscillator = 2 * charge_c * receiver.responsivity_a_per_w * receiver.local_oscillator_power_w
    thermal = 4 * boltzmann_j_per_k * receiver.temperature_k / receiver.transimpedance_ohm
    photons = 531.65 * power_w / 1e-12 * (oscillator + thermal) / (oscillator * (1 + share) + thermal)
    beams = echoes(3000 * bin_m, 5000 * bin_mps, power_w)
    snr_db = _receive(beams, build_receiver(PLAIN)).snr_db
    assert snr_db.item() == pytest.approx(10 * np.log10(photons), abs=0.03)


def test_beamlets_close_together_return_all_of_the_power() -> None:
    weight = np.random.default_rng(1).dirichlet(np.ones(19))
    one = _receive(echoes(1000.0, 20.0, 1e-10))
    shape = (1, 1, 19)
    many = _receive(echoes(np.full(shape, 1000.0), np.full(shape, 20.0), weight.reshape(shape) * 1e-10))
    assert many.snr_db[0, 0] == pytest.approx(one.snr_db[0, 0], abs=1e-5)


def test_beamlets_that_meet_nothing_change_nothing() -> None:
    beams = echoes(np.array([[[1000.0, np.nan, np.inf]]]), 20.0, np.array([[[1e-11, 0.0, 1e-11]]]))
    alone = _receive(echoes(1000.0, 20.0))
    for field in fields(Returns):
        np.testing.assert_array_equal(getattr(_receive(beams), field.name), getattr(alone, field.name))


def test_beyond_the_record_edge_the_rest_of_the_record_is_heard() -> None:
    """Half of the record's length later, half of the amplitude; a whole record later nothing."""
    waveform = PLAIN.waveform
    late_m = waveform.record_edge_range_m + 299_792_458.0 / 2 * waveform.record_time_s * np.array(
        [0.0, 0.5, 1.001]
    )
    returns = _receive(echoes(late_m, 20.0, 1e-9))
    assert returns.reason[0].tolist() == [Reason.BEYOND_RANGE] * 3
    assert returns.segments[0].tolist() == [7, 7, 0]
    assert np.diff(returns.snr_db[0, :2]) == pytest.approx(-6.02, abs=2.6)  # scalloping up to 1.8 dB, noise
    bin_mps = 1550e-9 * DF_HZ / 2
    in_constant = [
        _receive(echoes(np.full((400, 1, 1), r), 5000 * bin_mps, 1e-9)).snr_db.mean() for r in late_m[:2]
    ]
    assert np.diff(in_constant) == pytest.approx(-6.02, abs=2.6)


@pytest.mark.parametrize("range_rate_mps", [0.0, -92.388, 150.0])
def test_each_record_sees_the_range_and_the_carrier_of_its_own_time(range_rate_mps: float) -> None:
    model = build_receiver(plain(peak="jacobsen"))
    range_m = 2000.0 + np.random.default_rng(2).uniform(-5, 5, (200, 1, 1))
    returns = _receive(echoes(range_m, 20.0, 1e-7, range_rate_mps), model)
    expected = beats_hz(PLAIN.waveform, range_m[:, 0, 0], np.array(20.0), range_rate_mps)
    for segment in range(3):
        error_bin = (returns.segment_peak_hz[:, 0, segment] - expected[segment]) / DF_HZ
        assert abs(error_bin).max() < 2e-3  # SNR 77 dB; migration smears the chirps by 0.1 bins


SHORT = {"linewidth_hz": 0.0, "fft_length": 256}


@pytest.mark.parametrize("looks", [1, 4])
@pytest.mark.parametrize("wanted", [1e-3, 0.1])
def test_noise_alone_gives_false_alarms_at_the_rate_asked_for(wanted: float, looks: int) -> None:
    """Without any light, and with an echo far too weak to matter: N/2 - 1 independent bins in each record."""
    model = build_receiver(plain(SHORT, window="rect", false_alarm_probability=wanted, looks=looks))
    shots = 60_000 if looks == 1 else 20_000
    expected = 1 - (1 - wanted / 128) ** 127
    for power_w in (0.0, 1e-30):
        beams = echoes(np.full((shots, 1, 1), 12 * model.range_bin_m), 50 * model.speed_bin_mps, power_w)
        returns = _receive(beams, model)
        hits = [returns.segments >> segment & 1 for segment in range(3)]
        rate = np.mean(hits)
        assert abs(rate - expected) < 4 * np.sqrt(expected / (3 * shots))
        # Records are independent: all three at once is the rate's cube.
        both = np.mean(hits[0] & hits[2])
        assert abs(both - expected**2) < 4 * expected / np.sqrt(shots)
        _assert_consistent(returns, model.maximum_range_m)


@pytest.mark.parametrize("window", ["hann", "hamming"])
def test_false_alarms_under_a_window_are_those_of_windowed_noise(window: str) -> None:
    model = build_receiver(plain(SHORT, window=window, false_alarm_probability=0.1))
    shots = 60_000
    returns = _receive(echoes(np.full((shots, 1, 1), np.nan), 0.0, 0.0), model)
    rate = np.mean([returns.segments >> segment & 1 for segment in range(3)])
    a, b = {"hann": (0.5, 0.5), "hamming": (0.54, 0.46)}[window]
    weights = a - b * np.cos(2 * np.pi * np.arange(256) / 256)
    rng = np.random.default_rng(4)
    highest = [
        (abs(np.fft.rfft(weights * rng.standard_normal((10_000, 256))))[:, 1:-1] ** 2).max(axis=1)
        for _ in range(6)
    ]
    level = np.concatenate(highest) / (256 * (a * a + b * b / 2))
    expected = np.mean(level > model.threshold)
    # Bins 1 and N/2 - 1 are noisier than the others in a real record, 4 % of the rate.
    assert rate == pytest.approx(expected, rel=0.06)


@pytest.mark.parametrize("photons", [2.0, 5.0])
def test_an_echo_and_false_alarms_are_independent(photons: float) -> None:
    """A record without a target has neither: (1 - Marcum's Q1) (1 - P_fa)."""
    model = build_receiver(plain(SHORT, window="rect", false_alarm_probability=0.1))
    shots = 60_000
    power_w = photons / model.snr_per_w
    returns = _receive(
        echoes(np.full((shots, 1, 1), 12 * model.range_bin_m), 50 * model.speed_bin_mps, power_w), model
    )
    rate = np.mean(returns.segments >> 1 & 1)
    detected = ncx2.sf(2 * model.threshold, 2, 2 * photons)
    expected = 1 - (1 - detected) * (1 - 0.1 / 128) ** 126
    assert abs(rate - expected) < 4 * np.sqrt(expected / shots)


def test_false_alarms_lie_anywhere_in_the_band() -> None:
    model = build_receiver(plain(SHORT, window="rect", false_alarm_probability=0.5))
    returns = _receive(echoes(np.full((40_000, 1, 1), np.nan), 0.0, 0.0), model)
    peaks_hz = returns.segment_peak_hz[~np.isnan(returns.segment_peak_hz)]
    bins = np.rint(peaks_hz / model.bin_width_hz).astype(int)
    counts = np.bincount(bins, minlength=129)
    assert counts[[0, 128]].sum() == 0
    assert chisquare(counts[2:127]).pvalue > 1e-3


def test_a_strong_echo_hides_false_alarms() -> None:
    """Bins below 0.3 of the highest magnitude belong to no target."""
    model = build_receiver(plain(SHORT, window="rect", false_alarm_probability=0.5))
    place = (np.full((3000, 1, 1), 12 * model.range_bin_m), 50 * model.speed_bin_mps)
    strong = _receive(echoes(*place, 1e4 / model.snr_per_w), model)
    np.testing.assert_array_equal(
        np.rint(strong.segment_peak_hz / model.bin_width_hz), [[[38, 50, 62]]] * 3000
    )
    assert (strong.returns == 1).all()


def test_seed_shot_and_beam_change_the_noise() -> None:
    same = echoes(np.full((2, 2, 1), 1000.3), 20.0007)
    snr_db = np.concatenate([_receive(same, seed=seed).snr_db.ravel() for seed in (1, 2)])
    assert len(np.unique(snr_db)) == 8


def _assert_consistent(returns: Returns, maximum_range_m: float, least_segments: int = 3) -> None:
    """What holds whatever comes in."""
    valid = returns.reason == Reason.VALID
    segments = sum(
        (returns.segments >> segment & 1 for segment in range(3)), start=np.zeros(returns.segments.shape)
    )
    np.testing.assert_array_equal(returns.range_valid, valid)
    np.testing.assert_array_equal(returns.speed_valid, valid)
    for name in ("range_m", "closing_speed_mps", "sigma_range_m", "sigma_speed_mps"):
        np.testing.assert_array_equal(np.isfinite(getattr(returns, name)), valid, err_msg=name)
    assert np.isfinite(returns.residual_mps[valid & (segments == 3)]).all()
    np.testing.assert_array_equal(np.isfinite(returns.snr_db), segments > 0)
    for segment in range(3):
        detected = returns.segments >> segment & 1 == 1
        np.testing.assert_array_equal(np.isfinite(returns.segment_peak_hz[..., segment]), detected)
    assert (segments[valid] >= least_segments).all()
    assert (returns.returns[valid & (segments == 3)] >= 1).all()
    np.testing.assert_array_equal(np.isfinite(returns.second_range_m), returns.second_reason == Reason.VALID)
    np.testing.assert_array_equal(
        np.isfinite(returns.second_range_m), np.isfinite(returns.second_sigma_range_m)
    )
    assert (returns.returns[segments < 3] == 0).all()
    for measured in (returns.range_m, returns.second_range_m):
        known = measured[~np.isnan(measured)]
        assert ((known >= 0) & (known <= maximum_range_m)).all()


RANGES_M = st.one_of(
    st.floats(0, 14_000), st.sampled_from([0.0, 1e-300, 1e-9, 0.1, 12_000.0, 12_226.0, np.inf, -1.0, np.nan])
)
SPEEDS_MPS = st.one_of(
    st.floats(-465, 465),
    st.sampled_from([0.0, -0.0, 1e-12, 0.0035, 232.5, 465.0, 1e18, 1e300, np.inf, np.nan]),
)
RANGE_RATES_MPS = st.one_of(st.floats(-465, 465), st.sampled_from([0.0, 3e8, -3e8, np.inf, np.nan]))
POWERS_W = st.one_of(
    st.floats(1e-16, 1e-8), st.sampled_from([0.0, 1e-300, 1.0, 1e30, 1e300, 1.7e308, np.inf, np.nan])
)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(
    beamlets=st.lists(st.tuples(RANGES_M, SPEEDS_MPS, POWERS_W, RANGE_RATES_MPS), min_size=1, max_size=7),
    window=st.sampled_from(["rect", "hann", "hamming"]),
    peak=st.sampled_from(["bin", "parabola", "jacobsen", "hann", "aboutanios_mulgrew"]),
    estimator=st.sampled_from(
        [("chirp_minus_doppler", "all_three"), ("least_squares", "all_three"), ("least_squares", "any_two")]
    ),
    looks=st.sampled_from([1, 3]),
    ideal=st.booleans(),
    seed=st.integers(0, 2**63 - 1),
)
def test_nothing_absurd_comes_out_whatever_goes_in(
    beamlets: list[tuple[float, float, float, float]],
    window: str,
    peak: str,
    estimator: tuple[str, str],
    looks: int,
    ideal: bool,
    seed: int,
) -> None:
    combine, rule = estimator
    detection = {"window": window, "peak": peak, "combine": combine, "rule": rule, "looks": looks}
    detection["false_alarm_probability"] = 0.1
    instrument = plain(**detection) if ideal else Instrument(detection=Detection(**detection))
    columns = np.array(beamlets).T.reshape(4, 1, 1, -1)
    returns = _receive(echoes(*columns), build_receiver(instrument), seed)
    _assert_consistent(returns, 12_000.0, 2 if rule == "any_two" else 3)
