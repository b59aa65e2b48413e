"""The speckle within a measurement against its statistics, and the receiver's fading by it."""

from __future__ import annotations

import numpy as np
import pytest
from instruments import PLAIN_RECEIVER, echoes
from scipy import stats
from speckle_process import speckle_at, speckle_model

from lidar_emu.receiver.receiver import receive
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.speckle import streak_weight
from lidar_emu.receiver.speckle_field import PITCH_W
from lidar_emu.scenario.instrument import Detection, Instrument, Optics, Waveform

BEAMLETS, SHOTS = 61, 1000
TRAVEL_PER_S = 1500.0
RECORD_S = 2**17 / 600e6


def _process(
    time_s: list[float], shots: int = SHOTS, beams: int = 1, travel_per_s: float = TRAVEL_PER_S
) -> np.ndarray:
    """(shots, beams, times, beamlets)"""
    light = echoes(np.full((shots, beams, BEAMLETS), 500.0), 10.0, travel_per_s=travel_per_s)
    return speckle_at(speckle_model(), light, np.array(time_s), np.arange(shots))[..., 0, :]


@pytest.mark.slow
def test_weights_are_circular_gaussian_numbers_of_each_shot_beam_and_beamlet() -> None:
    z = _process([1e-4], beams=2)[:, :, 0]
    assert stats.kstest(abs(z.ravel()) ** 2, "expon").pvalue > 1e-3
    assert stats.kstest(np.angle(z.ravel()) / (2 * np.pi) + 0.5, "uniform").pvalue > 1e-3
    bound = 5 / np.sqrt(z.size)
    assert abs(np.mean(abs(z) ** 2) - 1) < bound
    assert abs(np.mean(z**2)) < bound * np.sqrt(2)
    for one, other in ((z[1:], z[:-1]), (z[:, :1], z[:, 1:]), (z[..., 1:], z[..., :-1])):
        assert abs(np.mean(one * np.conj(other))) < 5 / np.sqrt(one.size)


def _correlation(x: float) -> float:
    """Autocorrelation of the weights cos²(πx/3) √(8/9) within 3/2."""
    place = np.linspace(-3, 3, 6001)
    weight = np.sqrt(8 / 9) * np.cos(np.pi * place / 3) ** 2 * (abs(place) <= 1.5)
    return float(np.trapezoid(weight * np.interp(place - x, place, weight, 0, 0), place))


@pytest.mark.parametrize("pitches", [0.0, 0.1, 0.5, 0.8, 1.0, 1.2])
def test_correlation_over_a_distance(pitches: float) -> None:
    """Between any two times of a measurement, up or down the path."""
    step_s = pitches / TRAVEL_PER_S
    for start_s in (-4e-4, -0.5 * step_s, 4e-4 - step_s):
        before, after = np.moveaxis(_process([start_s, start_s + step_s]), 2, 0)
        mean, expected = np.mean(np.conj(before) * after), _correlation(pitches)
        assert abs(mean - expected) < 5 / np.sqrt(before.size)
    # Close to a Gaussian of the distance, with its curvature at 0.
    assert abs(expected - np.exp(-((PITCH_W * pitches) ** 2))) < 0.03


def test_process_is_continuous() -> None:
    step_s = 1e-10
    times_s = np.linspace(-4e-4, 4e-4, 300)
    values = _process([*times_s, *(times_s + step_s)], shots=20)
    # In single precision.
    assert abs(values[:, :, 300:] - values[:, :, :300]).max() < 20 * TRAVEL_PER_S * step_s + 3e-6


@pytest.mark.slow
def test_a_beamlet_has_the_same_numbers_among_any_others() -> None:
    """Whatever the number of beamlets, and whichever of them are lit."""
    few = echoes(np.full((5, 1, 3), 500.0), 10.0, travel_per_s=TRAVEL_PER_S)
    many = echoes(np.full((5, 1, 40), 500.0), 10.0, travel_per_s=TRAVEL_PER_S)
    dark = echoes(
        np.full((5, 1, 40), 500.0), 10.0, np.where(np.arange(40) == 2, 1e-11, 0.0), travel_per_s=TRAVEL_PER_S
    )
    times_s, shot = np.array([-3e-4, 3e-4]), np.arange(5)
    values = [speckle_at(speckle_model(), light, times_s, shot)[..., 0, :3] for light in (few, many, dark)]
    np.testing.assert_array_equal(values[0], values[1])
    np.testing.assert_array_equal(values[0][..., 2], values[2][..., 2])
    alone = speckle_at(speckle_model(), echoes(500.0, 10.0, travel_per_s=TRAVEL_PER_S), times_s, shot[3:4])
    np.testing.assert_array_equal(alone[0, ..., 0, 0], values[0][3, ..., 0])


@pytest.mark.parametrize("way_m", [0.0, 0.0054, 0.0108, 0.03])
def test_a_streak_crosses_the_beam(way_m: float) -> None:
    """From record to record its field has the correlation exp(-d²/w0²), about the time of validity."""
    waist_m, shots = Optics().waist_radius_m, 4000
    half = 0.5 * way_m / (PITCH_W * waist_m)
    before, after = (
        np.array([complex(*streak_weight(np.uint64(5), shot, 2, sense * half)) for shot in range(shots)])
        for sense in (-1.0, 1.0)
    )
    assert np.mean(np.abs(before) ** 2) == pytest.approx(1.0, abs=5 / np.sqrt(shots))
    found = np.mean(np.conj(before) * after)
    assert abs(found - np.exp(-((way_m / waist_m) ** 2))) < 0.03 + 4 / np.sqrt(shots)


def _instrument(looks: int = 1) -> Instrument:
    return Instrument(
        waveform=Waveform(linewidth_hz=0.0),
        optics=Optics(speckle=True),
        receiver=PLAIN_RECEIVER,
        detection=Detection(looks=looks, window="hann"),
    )


def _fading(travel_per_s: float, looks: int = 1, shots: int = 6000) -> np.ndarray:
    """Mean power of the three records of each shot, relative to a steady tone; tones close to their bins."""
    model = build_receiver(_instrument(looks=looks))
    shape = (shots, 1, 1)
    beams = echoes(
        np.full(shape, 3000 * model.range_bin_m),
        np.full(shape, 5000 * model.speed_bin_mps),
        1e8 / model.snr_per_w,
        travel_per_s=travel_per_s,
    )
    returns = receive(model, beams, np.arange(shots), 2)
    assert (returns.segments == 7).mean() > 0.999
    return 1e-8 * 10 ** (returns.snr_db[:, 0] / 10)


def _expected(step: float) -> tuple[float, float]:
    """Mean of the windowed record's power, and variance of the mean of three of them over that mean.

    The footprint moves by `step` pitches from record to record, and as fast within each of them.
    """
    offset = np.random.default_rng(7).uniform(0, 1, 20_000)
    corners = np.zeros((3, len(offset), 12))
    rows = np.arange(len(offset))
    time = (np.arange(32) + 0.5) / 32 - 0.5
    hann = 1 + np.cos(2 * np.pi * time)
    for segment in range(3):
        for t, share in zip(time, hann / hann.sum(), strict=True):
            x = 1 + offset + step * (segment + t * RECORD_S / 300e-6)
            nearest = np.rint(x).astype(int)
            for side in (-1, 0, 1):
                corner = nearest + side
                weight = np.sqrt(8 / 9) * np.cos(np.pi / 3 * (x - corner)) ** 2
                corners[segment, rows, corner + 1] += share * weight
    power = np.sum(corners[0] ** 2, axis=1)
    squares = [np.mean(np.sum(corners[a] * corners[b], axis=1) ** 2) for a in range(3) for b in range(3)]
    mean = float(np.mean(power))
    return mean, float(np.sum(squares) / 9) / mean**2


@pytest.mark.parametrize("step", [0.0, 0.4, 0.9, 1.5])
def test_segments_fade_together_as_far_as_the_footprint_stays(step: float) -> None:
    mean, variance = _expected(step)
    power = _fading(step / 300e-6)
    assert power.mean() == pytest.approx(mean, rel=5 / np.sqrt(6000) + 0.01)
    # A sample variance of exponential powers has a standard error of sqrt(8/n).
    assert np.var(power / power.mean()) == pytest.approx(variance, abs=4 * np.sqrt(8 / 6000))


def test_looks_shrink_fading() -> None:
    """Nine independent powers of three looks of three records."""
    moving = _fading(6e3, looks=3)
    assert np.var(moving / moving.mean()) == pytest.approx(1 / 9, abs=0.02)
    still = np.var(_fading(0.0, looks=3))
    assert still == pytest.approx(1, abs=4 * np.sqrt(8 / 6000))


def test_beamlets_add_their_powers() -> None:
    """19 beamlets within a hundredth of a bin have the sum of their powers as mean, and fade together exponentially."""
    model = build_receiver(_instrument())
    shots = 4000
    rng = np.random.default_rng(5)
    share = rng.dirichlet(np.ones(19))
    beams = echoes(
        np.full((shots, 1, 19), 3000 * model.range_bin_m),
        np.full((shots, 1, 19), 5000 * model.speed_bin_mps),
        share * 1e8 / model.snr_per_w,
    )
    power = 10 ** (receive(model, beams, np.arange(shots), 2).snr_db[:, 0] / 10) / 1e8
    assert power.mean() == pytest.approx(1, abs=5 / np.sqrt(shots) + 0.01)
    assert stats.kstest(power, "expon").pvalue > 1e-3
