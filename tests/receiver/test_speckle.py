"""The field of speckle against its statistics, and the receiver's fading by it."""

from __future__ import annotations

import numpy as np
import pytest
from instruments import PLAIN_RECEIVER, echoes
from scipy import stats

from lidar_emu.receiver.receiver import receive
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.speckle import PITCH_W, forget_corners, set_weights, speckle_field, streak_weight
from lidar_emu.scenario.instrument import Detection, Instrument, Optics, Waveform

BEAMLETS = 128

RECORD_S = 2**17 / 600e6


class _Field:
    """The field at one place after another, as a beam asks for it."""

    def __init__(self, beam: int = 0, keep: bool = True, beamlets: int = BEAMLETS) -> None:
        self._beam, self._keep = beam, keep
        self._field = speckle_field(beamlets)
        forget_corners(self._field)

    def __call__(self, east: float, north: float) -> np.ndarray:
        if not self._keep:
            forget_corners(self._field)
        set_weights(np.uint64(6), self._beam, east, north, self._field, self._field.weights[0])
        return self._field.weights[0, 0] + 1j * self._field.weights[0, 1]


def _places(count: int, seed: int = 4) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1e6, 1e6, (count, 2))


@pytest.mark.slow
def test_weights_are_circular_gaussian_numbers() -> None:
    z = np.array([_Field()(*place) for place in _places(1000)])
    assert stats.kstest(abs(z.ravel()) ** 2, "expon").pvalue > 1e-3
    assert stats.kstest(np.angle(z.ravel()) / (2 * np.pi) + 0.5, "uniform").pvalue > 1e-3
    bound = 5 / np.sqrt(z.size)
    assert abs(np.mean(abs(z) ** 2) - 1) < bound
    assert abs(np.mean(z**2)) < bound * np.sqrt(2)
    assert abs(np.mean(z[:, 1:] * np.conj(z[:, :-1]))) < bound
    other = np.array([_Field(beam=1)(*place) for place in _places(1000)])
    assert abs(np.mean(z * np.conj(other))) < bound


def _correlation(x: float) -> float:
    """Autocorrelation of the weights cos²(πx/3) √(8/9) within 3/2."""
    place = np.linspace(-3, 3, 6001)
    weight = np.sqrt(8 / 9) * np.cos(np.pi * place / 3) ** 2 * (abs(place) <= 1.5)
    return float(np.trapezoid(weight * np.interp(place - x, place, weight, 0, 0), place))


@pytest.mark.parametrize(
    ("east", "north"),
    [(0.1, 0), (0.5, 0), (0, -0.8), (1.0, 0), (-1.5, 0), (0, 2.0), (3.0, 0), (0.4, 0.7), (-1, 1)],
)
def test_correlation_over_a_distance(east: float, north: float) -> None:
    field, products = _Field(), []
    for place in _places(600):
        products.append(np.conj(field(*place)) * field(place[0] + east, place[1] + north))
    mean = np.mean(products)
    expected = _correlation(east) * _correlation(north)
    assert abs(mean - expected) < 5 / np.sqrt(np.size(products))
    # Close to a Gaussian of the distance, with its curvature at 0.
    if east * north == 0:
        assert abs(expected - np.exp(-(PITCH_W**2) * (east**2 + north**2))) < 0.03


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


def test_field_is_continuous() -> None:
    field = _Field()
    for x in (0.0, 3.5, -2.5, 1e6 + 0.5, 0.37):
        step = 1e-7
        assert abs(field(x + step, -5.2) - field(x - step, -5.2)).max() < 20 * step + 1e-8


@pytest.mark.parametrize("centre", [(0.0, 0.0), (-3.4, 7.7), (-1e9, 1e9), (2.0**31, -(2.0**31))])
def test_any_place_alone(centre: tuple[float, float]) -> None:
    """Corners kept from other places change nothing, whatever the order."""
    rng = np.random.default_rng(1)
    keeping, fresh = _Field(), _Field(keep=False)
    for offset in rng.uniform(-4, 4, (60, 2)):
        place = np.add(centre, offset)
        np.testing.assert_array_equal(keeping(*place), fresh(*place))
        assert np.isfinite(fresh(*place)).all()


def test_places_far_apart_differ() -> None:
    """Coordinates of either sign, and east and north, are distinguished."""
    z = [_Field()(x, y) for x, y in [(1.5, 2.5), (2.5, 1.5), (-1.5, 2.5), (1.5, -2.5), (-1.5, -2.5)]]
    for i, a in enumerate(z):
        for b in z[:i]:
            assert abs(np.mean(a * np.conj(b))) < 5 / np.sqrt(BEAMLETS)


def _instrument(looks: int = 1) -> Instrument:
    return Instrument(
        waveform=Waveform(linewidth_hz=0.0),
        optics=Optics(speckle=True),
        receiver=PLAIN_RECEIVER,
        detection=Detection(looks=looks, window="hann"),
    )


def _fading(drift_per_s: float, looks: int = 1, shots: int = 6000) -> np.ndarray:
    """Mean power of the three records of each shot, relative to a steady tone; tones close to their bins."""
    model = build_receiver(_instrument(looks=looks))
    shape = (shots, 1, 1)
    place = _places(shots)[:, None, :]
    beams = echoes(
        np.full(shape, 3000 * model.range_bin_m),
        np.full(shape, 5000 * model.speed_bin_mps),
        1e8 / model.snr_per_w,
        place=place,
        drift_per_s=(drift_per_s, 0.0),
    )
    returns = receive(model, beams, np.arange(shots), 2)
    assert (returns.segments == 7).mean() > 0.999
    return 1e-8 * 10 ** (returns.snr_db[:, 0] / 10)


def _expected(step: float) -> tuple[float, float]:
    """Mean of the windowed record's power, and variance of the mean of three of them over that mean.

    The field moves by `step` pitches from record to record, and as fast within each of them.
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
        place=_places(shots)[:, None, :],
    )
    power = 10 ** (receive(model, beams, np.arange(shots), 2).snr_db[:, 0] / 10) / 1e8
    assert power.mean() == pytest.approx(1, abs=5 / np.sqrt(shots) + 0.01)
    assert stats.kstest(power, "expon").pvalue > 1e-3
