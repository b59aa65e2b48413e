"""The receiver as a whole: published spot values, reasons, chance, and inputs at their extremes."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidar_emu.fmcw.reasons import Reason
from lidar_emu.fmcw.receiver import Echoes, ReceiverModel, Returns, build_receiver, receive
from lidar_emu.scenario.instrument import Detection, Instrument, Optics, Waveform

DEFAULT = build_receiver(Instrument())
JOINT = build_receiver(Instrument(detection=Detection(combine="least_squares", peak="hann")))
DF_HZ = 600e6 / 2**17


def _echoes(range_m: object, speed_mps: object, power_w: object = 1e-11) -> Echoes:
    """Beams of one beamlet each, in one shot; or whatever shape (shots, beams, beamlets) is given."""
    arrays = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in (range_m, speed_mps, power_w)))
    shaped = [np.array(a if a.ndim == 3 else np.reshape(a, (1, -1, 1))) for a in arrays]
    fired = np.ones(shaped[0].shape[:2], dtype=bool)
    return Echoes(*shaped, fired, ~fired)


def _receive(echoes: Echoes, model: ReceiverModel = DEFAULT, seed: int = 1) -> Returns:
    return receive(model, echoes, np.arange(len(echoes.fired)), seed)


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
    returns = _receive(_echoes(range_m, speed_mps))
    peaks_hz = returns.segment_peak_hz[0, 0]
    np.testing.assert_array_equal(np.rint(peaks_hz / DF_HZ), bins)
    assert peaks_hz[0] == pytest.approx(up_mhz * 1e6, abs=DF_HZ + 5e3)
    assert peaks_hz[2] == pytest.approx(down_mhz * 1e6, abs=DF_HZ + 5e3)
    assert returns.reason[0, 0] == Reason.VALID
    assert returns.segments[0, 0] == 7
    assert returns.range_m[0, 0] == pytest.approx(range_m, abs=0.3431)
    assert returns.closing_speed_mps[0, 0] == pytest.approx(speed_mps, abs=0.00178 + 5e-5)


@pytest.mark.parametrize("speed_mps", [-200.0, -150.0, -5.0, 40.0, 180.0, 225.0])
@pytest.mark.parametrize("range_m", [30.0, 1500.0, 9000.0])
def test_joint_estimate_follows_every_fold(range_m: float, speed_mps: float) -> None:
    returns = _receive(_echoes(range_m, speed_mps), JOINT)
    assert returns.sign_resolved[0, 0]
    assert returns.range_m[0, 0] == pytest.approx(range_m, abs=6 * returns.sigma_range_m[0, 0])
    assert returns.closing_speed_mps[0, 0] == pytest.approx(speed_mps, abs=6 * returns.sigma_speed_mps[0, 0])


def test_reasons() -> None:
    nan = np.nan
    echoes = _echoes(
        [1000, 1000, nan, 1000, 1000, 12_100, 12_400, 1000, -1.0, 0.0, np.inf, 1000],
        [20, 20, 20, 20, 20, 20, 20, 20, 20, 20, 20, nan],
        [1e-11, 1e-11, 0, 0, 1e-15, 1e-11, 1e-11, 1e-11, 1e-11, 1e-11, 1e-11, 1e-11],
    )
    echoes.fired[0, 1] = False
    echoes.inside[0, 7] = True
    returns = _receive(echoes)
    expected = [
        Reason.VALID,
        Reason.NOT_FIRED,
        Reason.NO_SURFACE,
        Reason.BELOW_THRESHOLD,
        Reason.BELOW_THRESHOLD,
        Reason.BEYOND_RANGE,  # measured, but beyond the maximum
        Reason.BEYOND_RANGE,  # past the record's edge: no echo at all
        Reason.INSIDE_GROUND,
        Reason.INSIDE_GROUND,
        Reason.INSIDE_GROUND,
        Reason.BEYOND_RANGE,
        Reason.BELOW_THRESHOLD,
    ]
    assert returns.reason[0].tolist() == expected
    assert returns.segments[0, 5] == 7
    assert returns.segments[0, 6] == 0
    assert returns.range_valid[0].tolist() == [r == Reason.VALID for r in expected]
    _assert_consistent(returns, DEFAULT.maximum_range_m)


def test_a_range_that_no_sign_explains_is_ambiguous() -> None:
    """At 1 mm, below the noise, every other range comes out negative: not reported, and no sign is sure."""
    shape = (400, 1, 1)
    speed_mps = 50 + np.random.default_rng(3).uniform(0, 0.1, shape)
    returns = _receive(_echoes(np.full(shape, 0.001), speed_mps), JOINT)
    assert set(returns.reason.ravel().tolist()) == {Reason.VALID, Reason.AMBIGUOUS}
    assert returns.sign_resolved.mean() < 0.02  # three standard deviations
    _assert_consistent(returns, JOINT.maximum_range_m)


def test_two_surfaces_are_two_returns() -> None:
    shape = (1, 1, 2)
    range_m = np.array([1000.0, 1040.0]).reshape(shape)
    power_w = np.array([4e-12, 2e-12]).reshape(shape)
    # Different speeds too: the constant segment has to tell the surfaces apart.
    speed_mps = np.array([20.0, 20.5]).reshape(shape)
    returns = _receive(_echoes(range_m, speed_mps, power_w), JOINT)
    assert returns.returns[0, 0] == 2
    assert returns.range_m[0, 0] == pytest.approx(1000, abs=0.05)
    assert returns.second_range_m[0, 0] == pytest.approx(1040, abs=0.05)
    alone = _receive(_echoes(1000.0, 20.0), JOINT)
    assert alone.returns[0, 0] == 1
    assert np.isnan(alone.second_range_m[0, 0])


def test_snr_is_the_number_of_photons_detected() -> None:
    """Tones on their bins in all segments: the mean over shots is K and the noise."""
    shots = 3000
    bin_mps = 1550e-9 * DF_HZ / 2
    bin_m = 299_792_458.0 * DF_HZ / (2 * 2e12)
    shape = (shots, 1, 1)
    for power_w in (1e-12, 4e-12):
        echoes = _echoes(np.full(shape, 3000 * bin_m), np.full(shape, 5000 * bin_mps), power_w)
        snr = 10 ** (_receive(echoes).snr_db / 10)
        photons = 531.65 * power_w / 1e-12
        # On the bin the Hamming window adds its noise bandwidth, 0.3974 / 0.54², to the mean.
        assert snr.mean() == pytest.approx(photons + 1.36, rel=0.005)


def test_beamlets_close_together_return_all_of_the_power() -> None:
    weight = np.random.default_rng(1).dirichlet(np.ones(19))
    one = _receive(_echoes(1000.0, 20.0, 1e-10))
    shape = (1, 1, 19)
    many = _receive(_echoes(np.full(shape, 1000.0), np.full(shape, 20.0), weight.reshape(shape) * 1e-10))
    assert many.snr_db[0, 0] == pytest.approx(one.snr_db[0, 0], abs=1e-9)


def test_beamlets_that_meet_nothing_change_nothing() -> None:
    echoes = _echoes(np.array([[[1000.0, np.nan, 12_500.0]]]), 20.0, np.array([[[1e-11, 0.0, 1e-11]]]))
    alone = _receive(_echoes(1000.0, 20.0))
    for field in fields(Returns):
        np.testing.assert_array_equal(getattr(_receive(echoes), field.name), getattr(alone, field.name))


def test_false_alarms_come_at_the_rate_asked_for() -> None:
    """Noise alone around one tone: 13 of 128 bins, independent under a rectangular window."""
    waveform = Waveform(fft_length=256)
    detection = Detection(window="rect", false_alarm_probability=0.5)
    model = build_receiver(Instrument(waveform=waveform, detection=detection))
    shots = 60_000
    shape = (shots, 1, 1)
    # Beat 12, Doppler shift 50 bins: tones at 38, 50 and 62, clear of the ends.
    range_m, speed_mps = 12 * model.range_bin_m, 50 * model.speed_bin_mps
    returns = _receive(_echoes(np.full(shape, range_m), np.full(shape, speed_mps), 1e-30), model)
    in_one_bin = 0.5 / 128
    expected = 1 - (1 - in_one_bin) ** 13
    for segment in range(3):
        rate = np.mean(returns.segments >> segment & 1)
        assert abs(rate - expected) < 4 * np.sqrt(expected / shots)


def _some_echoes(shots: int, beams: int = 4, beamlets: int = 7) -> Echoes:
    rng = np.random.default_rng(8)
    shape = (shots, beams, beamlets)
    range_m = rng.uniform(1, 13_000, shape[:2])[..., None] + rng.normal(0, 0.5, shape)
    speed_mps = rng.uniform(-230, 230, shape[:2])[..., None] + rng.normal(0, 0.02, shape)
    power_w = 10 ** rng.uniform(-15, -9, shape)
    range_m[rng.random(shape) < 0.1] = np.nan
    return Echoes(range_m, speed_mps, power_w, rng.random(shape[:2]) < 0.9, rng.random(shape[:2]) < 0.05)


@pytest.mark.parametrize("model", [DEFAULT, JOINT], ids=["published", "joint"])
def test_bits_do_not_depend_on_the_block(model: ReceiverModel) -> None:
    echoes = _some_echoes(60)
    shot = np.arange(1000, 1060)
    whole = receive(model, echoes, shot, 5)
    for size in (1, 7):
        for first in range(0, 60, size):
            part = slice(first, first + size)
            block = Echoes(*(getattr(echoes, field.name)[part] for field in fields(Echoes)))
            got = receive(model, block, shot[part], 5)
            for field in fields(Returns):
                np.testing.assert_array_equal(
                    getattr(got, field.name), getattr(whole, field.name)[part], err_msg=field.name
                )


def test_seed_shot_and_beam_change_the_noise() -> None:
    same = _echoes(np.full((2, 2, 1), 1000.3), 20.0007)
    snr_db = np.concatenate([_receive(same, seed=seed).snr_db.ravel() for seed in (1, 2)])
    assert len(np.unique(snr_db)) == 8


def _assert_consistent(returns: Returns, maximum_range_m: float) -> None:
    """What holds whatever comes in."""
    valid = returns.reason == Reason.VALID
    np.testing.assert_array_equal(returns.range_valid, valid)
    np.testing.assert_array_equal(returns.speed_valid, valid)
    for name in ("range_m", "closing_speed_mps", "sigma_range_m", "sigma_speed_mps"):
        np.testing.assert_array_equal(np.isfinite(getattr(returns, name)), valid, err_msg=name)
    assert np.isfinite(returns.residual_mps[valid]).all()
    assert np.isfinite(returns.snr_db[valid]).all()
    assert (returns.segments[valid] == 7).all()
    assert (returns.returns[valid] >= 1).all()
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
POWERS_W = st.one_of(
    st.floats(1e-16, 1e-8), st.sampled_from([0.0, 1e-300, 1.0, 1e30, 1e300, 1.7e308, np.inf, np.nan])
)


@settings(max_examples=300, deadline=None)
@given(
    beamlets=st.lists(st.tuples(RANGES_M, SPEEDS_MPS, POWERS_W), min_size=1, max_size=7),
    window=st.sampled_from(["rect", "hann", "hamming"]),
    peak=st.sampled_from(["bin", "hann"]),
    combine=st.sampled_from(["chirp_minus_doppler", "least_squares"]),
    seed=st.integers(0, 2**63 - 1),
)
def test_nothing_absurd_comes_out_whatever_goes_in(
    beamlets: list[tuple[float, float, float]], window: str, peak: str, combine: str, seed: int
) -> None:
    detection = Detection(window=window, peak=peak, combine=combine)  # type: ignore[arg-type]
    model = build_receiver(Instrument(detection=detection))
    columns = np.array(beamlets).T.reshape(3, 1, 1, -1)
    _assert_consistent(_receive(_echoes(*columns), model, seed), 12_000.0)


def test_no_surface_within_a_short_maximum_comes_back_as_a_short_range() -> None:
    """Beyond the maximum, but within the record: measured where it is, and refused."""
    for combine in ("chirp_minus_doppler", "least_squares"):
        detection = Detection(maximum_range_m=3000.0, combine=combine)
        model = build_receiver(Instrument(detection=detection))
        range_m = np.random.default_rng(6).uniform(3001, 12_200, (300, 1, 1))
        returns = _receive(_echoes(range_m, 60.0), model)
        assert set(returns.reason.ravel().tolist()) == {Reason.BEYOND_RANGE}


def test_detection_falls_off_with_the_photons() -> None:
    """The probability that an on-bin tone of SNR K crosses T is Marcum's Q1(sqrt(2K), sqrt(2T))."""
    from scipy.stats import ncx2

    optics = Optics()
    model = build_receiver(Instrument(optics=optics, detection=Detection(window="rect")))
    shots = 20_000
    shape = (shots, 1, 1)
    for photons in (12.0, 18.0, 25.0):
        echoes = _echoes(
            np.full(shape, 3000 * model.range_bin_m),
            np.full(shape, 5000 * model.speed_bin_mps),
            photons / model.snr_per_w,
        )
        rate = np.mean(_receive(echoes, model).segments >> 1 & 1)
        expected = ncx2.sf(2 * model.threshold, 2, 2 * photons)
        # The neighbours' noise adds at most 12 chances at the threshold, each exp(-18).
        assert rate == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / shots) + 2e-7)
