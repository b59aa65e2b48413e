"""False locks, against published rates, a closed form and chance with a fixed seed."""

from math import comb
from typing import get_args

import numpy as np
import pytest
from mpmath import mp, mpf

from lidar_emu.receiver.probability import (
    Fading,
    detection_probability,
    false_lock_probability,
    log_false_alarm,
    threshold_powers,
)

BINS = 2**16


def decibels(db):
    return 10 ** (np.asarray(db) / 10)


def test_published_rates_of_a_steady_tone():
    rates = false_lock_probability("steady", decibels([10, 13]), 0.0, BINS)
    np.testing.assert_allclose(rates, [0.59, 0.06], atol=0.005)


def test_published_rates_in_speckle():
    """A fifth at a mean of 17 dB, 1.2 % at 30 dB."""
    rates = false_lock_probability("swerling_2", decibels([17, 30]), 0.0, BINS)
    np.testing.assert_allclose(rates, [0.20, 0.012], atol=0.005)


@pytest.mark.parametrize("bins", [1, 2, 100, BINS])
@pytest.mark.parametrize("db", [-20, 0, 10, 30, 60])
def test_closed_form_in_speckle(db, bins):
    """Without a threshold 1 - Γ(1 + x) Γ(N + 1) / Γ(N + 1 + x), with x = 1/(1 + K)."""
    snr = float(decibels(db))
    with mp.workdps(30):
        x = 1 / (1 + mpf(snr))
        expected = 1 - mp.gammaprod([1 + x, bins + 1], [bins + 1 + x])
    locked = false_lock_probability("swerling_2", snr, 0.0, bins)
    assert float(locked) == pytest.approx(float(expected), abs=1e-11)


@pytest.mark.parametrize("bins", [1, 7])
def test_one_or_few_bins_beside_a_steady_tone(bins):
    """The probability that all of N exponential powers are below a Rician one, term by term."""
    snr = 3.0
    # E[e^-kp] of the signal's power p is e^(-K k/(1 + k)) / (1 + k).
    below = sum((-1) ** k * comb(bins, k) * np.exp(-snr * k / (1 + k)) / (1 + k) for k in range(bins + 1))
    assert float(false_lock_probability("steady", snr, 0.0, bins)) == pytest.approx(1 - below, abs=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("threshold", [0.0, 6.0, 9.0])
@pytest.mark.parametrize("fading", get_args(Fading))
@pytest.mark.parametrize("looks", [1, 4])
def test_drawn_by_chance(fading, looks, threshold):
    bins, snr, count = 200, 4.0, 20_000
    chance = np.random.default_rng([7, looks, int(threshold), fading == "steady"])
    noise = chance.gamma(looks, 1.0, (count, bins)).max(axis=1)
    shape = (count, looks)
    power = np.full(shape, snr) if fading == "steady" else chance.exponential(snr, shape)
    own = np.sqrt(0.5) * (chance.normal(size=shape) + 1j * chance.normal(size=shape))
    signal = (np.abs(np.sqrt(power) + own) ** 2).sum(axis=1)
    locked = (noise > np.maximum(signal, threshold_powers(threshold, looks) if threshold else 0.0)).mean()
    expected = float(false_lock_probability(fading, snr, threshold, bins, looks))
    assert locked == pytest.approx(expected, abs=5 * np.sqrt(expected * (1 - expected) / count))


def test_limits():
    """Without a signal nearly every alarm is a false lock; the threshold bounds them."""
    threshold = np.log(BINS / 1e-3)
    alarm = np.exp(log_false_alarm(threshold, BINS))
    rates = false_lock_probability("steady", decibels([-60, 0, 10, 20, 60]), threshold, BINS)
    assert rates[0] == pytest.approx(alarm, rel=1e-6)
    assert (np.diff(rates) <= 0).all()
    assert rates[-1] == 0.0
    missed = 1 - detection_probability("steady", decibels(10), threshold)
    assert rates[2] > alarm * missed
