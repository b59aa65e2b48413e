"""Smear by motion and the laser's line, against quadrature, chirped samples and a laser's phase walking at random."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import numpy as np
import pytest
from instruments import plain

from lidar_emu.numerics.arrays import as_record
from lidar_emu.numerics.random_streams import LINE, Normals, draw_words, normals, set_normals
from lidar_emu.receiver.bin_filter import convolve_taps, most_taps, widest_filter
from lidar_emu.receiver.laser_phase_noise import (
    LineArrays,
    line_arrays,
    line_numbers,
    normal_taps,
    set_line_amplitudes,
    walked_taps,
)
from lidar_emu.receiver.motion_smear import LEAST_TAPS, smear_taps
from lidar_emu.receiver.receiver_constants import build_receiver

RECORD_S = 2**17 / 600e6


def _smear(beta: float, half: int) -> np.ndarray:
    taps = np.empty((2, 2 * half + 1), dtype=np.float32)
    smear_taps(beta, half, taps)
    return taps


@pytest.mark.parametrize("size", [0.01, 0.1, 0.5, 1.0, 1.999, 2.0, 2.001, 6.0, 62.0, 300.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("extra", [0, 30])
def test_smear_taps_are_fourier_coefficients(size: float, sign: float, extra: int) -> None:
    half = LEAST_TAPS + int(size / 2) + extra
    node, weight = np.polynomial.legendre.leggauss(20)
    edges = np.linspace(-0.5, 0.5, 401)
    x = (edges[:-1, None] + (node + 1) / 800).ravel()
    share = np.tile(weight / 800, 400)
    m = np.arange(-half, half + 1)
    factor = share * np.exp(1j * np.pi * sign * size * x * x)
    expected = np.exp(-2j * np.pi * m[:, None] * x) @ factor
    taps = _smear(sign * size, half)
    # Rounded to single precision, panel by panel.
    assert abs(taps[0] + 1j * taps[1] - expected).max() < 5e-7 * (1 + size / 50)


# The grid cuts off the tails of tones and taps; a window leaves little of that.
def test_taps_of_a_product() -> None:
    rng = np.random.default_rng(2)
    half = 9
    first, second = (rng.standard_normal((2, 2 * half + 1)).astype(np.float32) for _ in range(2))
    result = np.empty((2, 2 * half + 1), dtype=np.float32)
    convolve_taps(first, second, half, result)
    expected = np.convolve(first[0] + 1j * first[1], second[0] + 1j * second[1])[half : 3 * half + 1]
    np.testing.assert_allclose(result[0] + 1j * result[1], expected, atol=1e-5)


@pytest.mark.parametrize("linewidth_hz", [0.0, 30e3])
@pytest.mark.parametrize("ripple_hz", [0.0, 2e4])
def test_the_taps_reserved_are_enough_for_each_beam(linewidth_hz: float, ripple_hz: float) -> None:
    keys = {"linewidth_hz": linewidth_hz, "ripple_hz": ripple_hz, "ripple_frequency_hz": 3e4}
    models, rng = as_record(build_receiver(plain(keys))), np.random.default_rng(5)
    seen = set()
    for _ in range(200):
        range_m, speed_mps = 10 ** rng.uniform(0, 4, (2, 3, 5)), rng.uniform(-1, 1, (2, 3, 5))
        speed_mps *= 10 ** rng.uniform(0, 5)
        range_m[rng.random(range_m.shape) < 0.2] = np.nan
        acceleration_mps2 = rng.choice([0.0, 10.0, -1e3, np.nan], (2, 3))
        enough = most_taps(models, range_m, speed_mps, acceleration_mps2)
        each = [
            widest_filter(models[0], range_m[k], speed_mps[k], np.nan_to_num(acceleration_mps2[k[:2]]), power)
            for k in np.ndindex(range_m.shape)
            for power in (0.0, 1e-6)
            if np.isfinite(range_m[k])
        ]
        assert max(each) <= enough
        seen.add(enough)
    assert len(seen) > 1


Taps = Callable[[float, float, int, int, Normals, LineArrays, np.ndarray], None]


def _drawn(linewidth: float, delay: float, half: int, shots: int, set_taps: Taps = normal_taps) -> np.ndarray:
    """(shots, 2 half + 1) taps of the laser's line."""
    taps, arrays = np.empty((shots, 2, 2 * half + 1), dtype=np.float32), line_arrays(half)
    model = build_receiver(plain({"linewidth_hz": linewidth / RECORD_S}))
    count = 2 * (half + 2) if set_taps is normal_taps else arrays.phasors.shape[1]
    set_line_amplitudes(linewidth, delay, half, arrays.amplitudes)
    drawn, range_m = normals(count), delay / model.delay_per_m
    # Enough are reserved; `normal_taps` are not the product's choice for each of these lines.
    assert set_taps is normal_taps or line_numbers(as_record(model)[0], range_m, half) <= count
    for shot in range(shots):
        draw_words(np.uint64(8), shot, 1, LINE, 0, count, 0, drawn.words)
        set_normals(count, drawn)
        set_taps(linewidth, delay, half, 0, drawn, arrays, taps[shot])
    return taps[:, 0] + 1j * taps[:, 1].astype(float)


def _walked(linewidth: float, delay: float, half: int, records: int) -> np.ndarray:
    """The same of a laser whose phase walks at random: the transform of exp(jΔφ), referred to the record's centre."""
    rng = np.random.default_rng(21)
    # Steps of a whole fraction of the delay.
    samples = 4096
    lag = max(1, round(delay * samples))
    per_step = delay / lag
    length = round(1 / per_step)
    stride = max(1, length // samples)
    m = np.arange(-half, half + 1)
    taps = np.empty((records, 2 * half + 1), dtype=complex)
    for record in range(records):
        if stride == 1:
            walk = np.cumsum(rng.standard_normal(length + lag) * sqrt(2 * np.pi * linewidth * per_step))
            drift = walk[lag:] - walk[:-lag]
        else:
            drift = rng.standard_normal(length // stride) * sqrt(2 * np.pi * linewidth * delay)
        spectrum = np.fft.fft(np.exp(1j * drift)) / len(drift)
        taps[record] = spectrum[m] * np.exp(1j * np.pi * m)
    return taps


# 3, 30 and 300 kHz at delays up to 80 µs: ranges to 12 km.
@pytest.mark.slow
@pytest.mark.parametrize("delay_us", [0.1, 2.0, 14.0, 80.0])
@pytest.mark.parametrize("linewidth_khz", [3.0, 30.0, 300.0])
def test_line_is_that_of_a_laser_walking_at_random(linewidth_khz: float, delay_us: float) -> None:
    linewidth, delay = linewidth_khz * 1e3 * RECORD_S, delay_us * 1e-6 / RECORD_S
    half = LEAST_TAPS + (int(2 * linewidth) if 2 * np.pi * linewidth * delay > 0.5 else 0)
    ours, walked = _drawn(linewidth, delay, half, 3000), _walked(linewidth, delay, half, 1500)
    drift = 2 * np.pi * linewidth * delay
    error = 5 * sqrt(1 / len(ours) + 1 / len(walked))
    # Correlations belong to an endless record: delays that are a part of it shift up to a third of that part
    # from the lowest taps to those where an endless record's spectrum is empty.
    coarse = error + delay / 3
    powers, pseudo = [], []
    for taps in (ours, walked):
        centre_error = 5 * sqrt(np.mean(abs(taps[:, half]) ** 2) / len(taps))
        assert abs(taps[:, half].mean() - np.exp(-drift / 2)) < centre_error
        drawn = taps - np.exp(-drift / 2) * (np.arange(2 * half + 1) == half)
        powers.append(np.mean(abs(drawn) ** 2, axis=0))
        pseudo.append(np.mean(drawn * drawn[:, ::-1], axis=0))
    assert powers[0].sum() == pytest.approx(powers[1].sum(), rel=coarse / 2)
    assert abs(powers[0] - powers[1]).max() < coarse * powers[1].max()
    assert abs(pseudo[0] - pseudo[1]).max() < coarse * powers[1].max()
    if drift < 0.3:  # phase noise alone: c₋ₘ = -conj cₘ
        assert (pseudo[0].real < -0.7 * powers[0]).all()
        assert (pseudo[1].real < -0.7 * powers[1]).all()


def _peaks(taps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance in bins of the highest Hamming-windowed bin from the line's centre, and its power."""
    side = 0.23 / 0.54
    power = abs(taps[:, 1:-1] + side * (taps[:, 2:] + taps[:, :-2])) ** 2
    return abs(power.argmax(axis=1) - power.shape[1] // 2), power.max(axis=1)


# 3 kHz at 4, 5 and 8 km, 10 kHz at 2 km, and a delay of more than a record.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("linewidth", "delay"), [(0.66, 0.122), (0.66, 0.154), (0.66, 0.244), (2.2, 0.061), (0.66, 1.3)]
)
def test_peaks_of_a_line_that_wanders(linewidth: float, delay: float) -> None:
    """Independent Gaussian taps have half as many peaks beside the centre of the second line, 5 km at 3 kHz."""
    half = LEAST_TAPS + 2 * int(np.ceil(linewidth))
    ours, walked = _drawn(linewidth, delay, half, 4000, walked_taps), _walked(linewidth, delay, half, 4000)
    drift = 2 * np.pi * linewidth * delay
    if delay < 1:
        # The phase common to a record is uniform beyond.
        assert abs(ours[:, half].mean() - np.exp(-drift / 2)) < 4 * sqrt(1 / len(ours))
    (off, power), (walked_off, walked_power) = _peaks(ours), _peaks(walked)
    for distance in (1, 2, 3):
        shares = (off >= distance).mean(), (walked_off >= distance).mean()
        assert abs(shares[0] - shares[1]) < 4 * sqrt((sum(shares) + 1e-3) / len(ours))
    for percent in (5, 25, 50, 75, 95):
        value, wanted = np.percentile(power, percent), np.percentile(walked_power, percent)
        assert value == pytest.approx(wanted, abs=0.02)
    wide, walked_wide = (np.mean(abs(taps) ** 2, axis=0) for taps in (ours, walked))
    assert abs(wide - walked_wide).max() < 5 * sqrt(2 / len(ours)) * walked_wide.max()
