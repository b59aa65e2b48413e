"""Thresholds and false alarms of noise alone, against scipy.stats and multiple precision."""

import numpy as np
import pytest
from mpmath import mp, mpf
from scipy.stats import gamma

from lidar_emu.receiver.probability import log_false_alarm, minus_log_exceedance, threshold_powers

LOOKS = [1, 2, 5, 16, 64]


@pytest.mark.parametrize("looks", LOOKS)
@pytest.mark.parametrize("power", [1e-3, 0.3, 1.0, 4.7, 60.0, 70.0, 800.0, 1e4])
def test_exceedance_in_logarithms(looks, power):
    with mp.workdps(300):
        reference = -mp.log(mp.gammainc(looks, mpf(power), regularized=True))
        if reference > mpf("1e-300"):
            assert abs(mpf(float(minus_log_exceedance(power, looks))) / reference - 1) < 1e-13


@pytest.mark.parametrize("looks", LOOKS)
def test_threshold_is_the_inverse(looks):
    wanted = np.array([1e-6, 0.3, 0.999, 1.001, 3.0, 18.0, 690.0, 5e3, 1e5])
    power = threshold_powers(wanted, looks)
    exceeded = [minus_log_exceedance(each, looks) for each in power.tolist()]
    np.testing.assert_allclose(exceeded, wanted, rtol=1e-13)
    ordinary = wanted < 690
    np.testing.assert_allclose(power[ordinary], gamma.isf(np.exp(-wanted[ordinary]), looks), rtol=1e-10)


@pytest.mark.parametrize("bins", [1, 2, 2**16])
@pytest.mark.parametrize("single", [1e-3, 2.0, 18.0, 45.0, 60.0, 700.0, 1e4])
def test_highest_of_many_bins(bins, single):
    with mp.workdps(5000):
        reference = mp.log(1 - (1 - mp.exp(-mpf(single))) ** bins)
        if bins * mp.exp(-single) < 30:
            assert float(log_false_alarm(single, bins)) == pytest.approx(
                float(reference), rel=1e-12, abs=1e-13
            )
