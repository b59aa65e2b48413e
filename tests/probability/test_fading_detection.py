"""Detection of steady and fading tones: textbook forms, scipy.stats, and chance with a fixed seed."""

from typing import get_args

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import ncx2, rice

from lidar_emu.receiver.probability import (
    Fading,
    detection_probability,
    shared_fade_probability,
    threshold_powers,
)

SNR = np.array([0.0, 1e-6, 0.03, 0.8, 3.0, 20.0, 100.0, 1e5])
PFA = 18.0
CASES = get_args(Fading)


def test_a_steady_tone_is_rices():
    expected = rice.sf(np.sqrt(2 * PFA), np.sqrt(2 * SNR[:-1]))
    np.testing.assert_allclose(detection_probability("steady", SNR[:-1], PFA), expected, atol=1e-11)


def test_a_single_look_in_speckle_is_rayleighs():
    expected = np.exp(-PFA / (1 + SNR))
    np.testing.assert_allclose(detection_probability("swerling_2", SNR, PFA), expected, rtol=1e-13)


@pytest.mark.parametrize("looks", [1, 2, 3, 8])
@pytest.mark.parametrize("fading", CASES)
def test_fades_drawn_by_chance(fading, looks):
    snr, minus_log_pfa, count = 1.3, 4.0, 200_000
    chance = np.random.default_rng([looks, CASES.index(fading)])
    shape = (count, looks)
    signal = np.full(shape, snr) if fading == "steady" else chance.exponential(snr, shape)
    noise = np.sqrt(0.5) * (chance.normal(size=shape) + 1j * chance.normal(size=shape))
    total = (np.abs(np.sqrt(signal) + noise) ** 2).sum(axis=1)
    detected = float((total > threshold_powers(minus_log_pfa, looks)).mean())
    expected = float(detection_probability(fading, snr, minus_log_pfa, looks))
    assert detected == pytest.approx(expected, abs=5 * np.sqrt(expected * (1 - expected) / count))


@pytest.mark.parametrize("looks", [1, 2, 7, 64])
@pytest.mark.parametrize("fading", CASES)
def test_without_signal_only_false_alarms_remain(fading, looks):
    minus_log_pfa = np.array([0.1, 3.0, 18.0])
    detected = detection_probability(fading, 0.0, minus_log_pfa, looks)
    np.testing.assert_allclose(detected, np.exp(-minus_log_pfa), rtol=1e-9)


@pytest.mark.parametrize("fading", CASES)
def test_no_threshold_is_too_high(fading):
    """P_fa = 1e-300 and far below."""
    detected = detection_probability(fading, [700.0, 1e5], [[690.8], [5000.0]], 2)
    assert ((detected >= 0) & (detected <= 1)).all()
    assert detected[1, 0] < detected[0, 0]
    assert detected[0, 1] > 0.97


@pytest.mark.parametrize("looks", [1, 3, 16])
def test_a_fade_of_one_segment_is_swerling_2(looks):
    shared = shared_fade_probability(lambda p: p, SNR, PFA, looks)
    np.testing.assert_allclose(shared, detection_probability("swerling_2", SNR, PFA, looks), atol=1e-10)


@pytest.mark.parametrize("snr", [0.5, 8.0, 300.0])
def test_three_segments_in_one_fade(snr):
    def density(power):
        return ncx2.sf(2 * PFA, 2, 2 * power) ** 3 * np.exp(-power / snr) / snr

    expected = quad(density, 0, 120, limit=400, epsabs=1e-12)[0] + np.exp(-120 / snr)
    shared = shared_fade_probability(lambda p: p**3, snr, PFA)
    assert shared == pytest.approx(expected, abs=1e-9)
    alone = detection_probability("swerling_2", snr, PFA)
    assert alone**3 < shared < alone
