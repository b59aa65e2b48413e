"""The published quantisation figures and the three-bin estimate, from shots of the whole receiver.

`pytest -s` prints the figures of the table in docs/accuracy.md.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from instruments import C_MPS, PLAIN, beats_hz, echoes, estimates, plain

from lidar_emu.receiver.receiver import receive
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.returns import Returns

Shots = tuple[np.ndarray, np.ndarray, Returns]
SHOTS = 40_000
LAMBDA_M = 1550e-9
SLOPE = 2e12


def _measure(snr_db: float, shots: int = SHOTS, **detection: str) -> Shots:
    """One tone per beam at random places within bins: true range, true speed, returns."""
    model = build_receiver(plain(**detection))
    rng = np.random.default_rng(17)
    range_m = 2164.784 + rng.uniform(-20, 20, (shots, 1, 1))
    speed_mps = 92.388 + rng.uniform(-0.5, 0.5, (shots, 1, 1))
    power_w = 10 ** (snr_db / 10) / model.snr_per_w
    returns = receive(model, echoes(range_m, speed_mps, power_w), np.arange(shots), 1)
    return range_m[:, 0, 0], speed_mps[:, 0, 0], returns


def _deviations(measured: Shots) -> tuple[float, float]:
    """Standard deviations of range and closing speed."""
    range_m, speed_mps, returns = measured
    errors = returns.range_m[:, 0] - range_m, returns.closing_speed_mps[:, 0] - speed_mps
    return float(np.std(errors[0])), float(np.std(errors[1]))


@pytest.fixture(scope="module")
def published() -> Shots:
    return _measure(60.0)


@pytest.fixture(scope="module")
def joint() -> Shots:
    return _measure(60.0, combine="least_squares")


# Tolerances are four standard errors of a standard deviation over 40 000 shots, and the figures' last digit.
def test_range_is_9_9_cm_where_the_doppler_shift_is_known(published: Shots) -> None:
    range_m, speed_mps, returns = published
    beat_hz = returns.segment_peak_hz[:, 0, 2] - 2 * speed_mps / LAMBDA_M
    found_m = np.std(beat_hz * C_MPS / (2 * SLOPE) - range_m)
    print(f"range, quantised, Doppler shift known: {100 * found_m:.2f} cm")
    assert found_m == pytest.approx(0.09904, rel=0.012)


def test_published_detector_is_14_cm_and_1_024_mm_per_s(published: Shots) -> None:
    _, _, returns = published
    assert returns.range_valid.all()
    found_m, found_mps = _deviations(published)
    print(f"published detector: {100 * found_m:.2f} cm, {1e3 * found_mps:.3f} mm/s")
    assert found_m == pytest.approx(0.1400, rel=0.015)
    assert found_mps == pytest.approx(1.0241e-3, rel=0.012)
    assert returns.sigma_range_m[0, 0] == pytest.approx(0.3430850 / np.sqrt(6), rel=1e-5)
    assert returns.sigma_speed_mps[0, 0] == pytest.approx(3.5476685e-3 / np.sqrt(12), rel=1e-5)


def test_least_squares_is_7_cm_and_0_591_mm_per_s(joint: Shots) -> None:
    _, _, returns = joint
    assert returns.range_valid.all()
    assert _deviations(joint) == pytest.approx((0.0700, 0.591e-3), rel=0.015)
    assert returns.sigma_range_m[0, 0] == pytest.approx(0.3430850 / np.sqrt(24), rel=1e-5)
    assert returns.sigma_speed_mps[0, 0] == pytest.approx(3.5476685e-3 / 6, rel=1e-5)


@pytest.mark.parametrize(("peak", "over_bound"), [("hann", 1.8), ("aboutanios_mulgrew", 1.03)])
def test_least_squares_of_sub_bin_peaks(peak: str, over_bound: float) -> None:
    """So many times the Cramér-Rao bound of 0.3898 bin / sqrt(snr), over the roots of two and three beats."""
    found_m, found_mps = _deviations(_measure(33.0, peak=peak, combine="least_squares"))
    print(f"least squares, {peak}, 33 dB: {100 * found_m:.2f} cm, {1e3 * found_mps:.3f} mm/s")
    beat_bin = over_bound * 0.3898 / 10**1.65
    assert found_m == pytest.approx(beat_bin / np.sqrt(2) * 0.343085, rel=0.03)
    assert found_mps == pytest.approx(beat_bin / np.sqrt(3) * 3.547668e-3, rel=0.03)


def _expected(range_m: np.ndarray, speed_mps: np.ndarray, combine: str) -> tuple[np.ndarray, np.ndarray]:
    return estimates(PLAIN.waveform, beats_hz(PLAIN.waveform, range_m, speed_mps), combine)


@pytest.mark.parametrize("combine", ["chirp_minus_doppler", "least_squares"])
def test_biases_are_those_of_the_chirps_optical_frequency(
    combine: str, published: Shots, joint: Shots
) -> None:
    """-1.6 cm of the published detector: its down-chirp's record lies 380 MHz below the constant segment."""
    range_m, speed_mps, returns = joint if combine == "least_squares" else published
    expected_m, expected_mps = _expected(range_m, speed_mps, combine)
    for measured, expected, true in (
        (returns.range_m[:, 0], expected_m, range_m),
        (returns.closing_speed_mps[:, 0], expected_mps, speed_mps),
    ):
        error = measured - expected
        assert abs(error.mean()) < 4 * np.std(error) / np.sqrt(SHOTS)
        assert abs(np.mean(expected - true)) < 0.25 * np.std(error)


@pytest.mark.parametrize("page", ["README.md", "docs/accuracy.md"])
def test_the_pages_print_these_figures(page: str, published: Shots, joint: Shots) -> None:
    range_m, speed_mps, returns = published
    beat_hz = returns.segment_peak_hz[:, 0, 2] - 2 * speed_mps / LAMBDA_M
    fine_m, fine_mps, fine = _measure(33.0, combine="least_squares", peak="aboutanios_mulgrew")
    figures = [
        f"{100 * np.std(beat_hz * C_MPS / (2 * SLOPE) - range_m):.2f} cm",
        f"{1e3 * np.std(returns.closing_speed_mps[:, 0] - speed_mps):.3f} mm/s",
        f"{100 * np.std(returns.range_m[:, 0] - range_m):.2f} cm",
        f"{100 * np.nanstd(fine.range_m[:, 0] - fine_m):.2f} cm, "
        f"{1e3 * np.nanstd(fine.closing_speed_mps[:, 0] - fine_mps):.3f} mm/s",
    ]
    if page == "README.md":
        figures = figures[:1]
    else:
        range_m, speed_mps, returns = joint
        figures.append(f"{100 * np.std(returns.range_m[:, 0] - range_m):.2f} cm")
        figures.append(f"{1e3 * np.std(returns.closing_speed_mps[:, 0] - speed_mps):.3f} mm/s")
    text = (Path(__file__).parents[2] / page).read_text(encoding="utf-8")
    assert [figure for figure in figures if f"| {figure} |" not in text] == []
