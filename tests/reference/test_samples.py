"""The phase of a record against 40 digits, and against the beat frequencies that follow from it."""

from __future__ import annotations

import numpy as np
import pytest
from beamlet_samples import Beamlets, analytic_record, phase_cycles
from mpmath import mp, mpf

from lidar_emu.reference.laser_sweep import Segment, frequency_plan, record_times
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Waveform

C = mpf(SPEED_OF_LIGHT_MPS)
SHORT = Waveform(fft_length=256, sample_rate_hz=600e6 / 512)
"""A record as long as the default one, with few samples."""


def _frequencies(waveform: Waveform, index: int) -> tuple[mpf, mpf, mpf]:
    """Frequency at a segment's start, slope in it and slope before it."""
    slope = mpf(waveform.chirp_slope_hz_per_s) * (1 + mpf(waveform.slope_error))
    nominal = C / mpf(waveform.wavelength_m)
    before, here = [(-slope, slope), (slope, mpf(0)), (mpf(0), -slope)][index]
    return (nominal - slope * mpf(waveform.segment_time_s) if index == 0 else nominal), here, before


def _exact_cycles(
    waveform: Waveform, index: int, scatterer: tuple[float, float, float], time_s: float, edges: bool
) -> mpf:
    """Phase of the laser less the echo's, in cycles: integrals of the frequency, all 1e10 of them."""
    start_hz, slope, before = _frequencies(waveform, index)

    def laser(u: mpf) -> mpf:
        return start_hz * u + (before if edges and u < 0 else slope) * u * u / 2

    range_m, speed_mps, acceleration_mps2 = map(mpf, scatterer)
    t = mpf(time_s)
    u = mpf(waveform.segment_time_s) - mpf(waveform.fft_length) / mpf(waveform.sample_rate_hz) / 2 + t
    delay = 2 * (range_m - speed_mps * t - acceleration_mps2 * t * t / 2) / C
    return laser(u) - laser(u - delay)


@pytest.mark.parametrize("index", [0, 1, 2], ids=["up", "constant", "down"])
@pytest.mark.parametrize(
    ("scatterer", "edges"),
    [
        ((2164.784, 92.388, 0.0), False),
        ((30.0, -5.0, 100.0), False),
        ((541.196, 229.5641, 1000.0), False),
        ((11999.0, 230.0, -1000.0), True),
        ((20000.0, 92.388, 100.0), True),
        ((40000.0, -300.0, 1000.0), True),
    ],
)
def test_phase_against_forty_digits(index: int, scatterer: tuple[float, float, float], edges: bool) -> None:
    waveform = Waveform(fft_length=256, sample_rate_hz=600e6 / 512, slope_error=1e-3)
    time_s = record_times(waveform)
    ours = phase_cycles(frequency_plan(waveform)[index], *scatterer, time_s, edges)
    with mp.workdps(40):
        centre = _exact_cycles(waveform, index, scatterer, 0.0, edges)
        exact = [_exact_cycles(waveform, index, scatterer, t, edges) - centre for t in time_s]
        worst = max(abs(mpf(x) - y) for x, y in zip(ours.tolist(), exact, strict=True))
    assert max(abs(y) for y in exact) > 100
    assert worst < 3e-10


@pytest.mark.parametrize("index", [0, 1, 2], ids=["up", "constant", "down"])
def test_record_against_forty_digits(index: int) -> None:
    scatterers = [(2164.784, 92.388, 100.0), (2171.5, 90.1, 100.0)]
    weight = np.array([2.0 - 1.0j, 0.5 + 0.25j])
    range_m, speed_mps, _ = np.array(scatterers).T
    beamlets = Beamlets(range_m, speed_mps, 100.0, weight)
    ours = analytic_record(SHORT, frequency_plan(SHORT)[index], beamlets).real
    sign = 1 if index == 0 else -1
    for n in range(0, 256, 5):
        time_s = float(record_times(SHORT)[n])
        with mp.workdps(40):
            exact = mpf(0)
            for scatterer, w in zip(scatterers, weight.tolist(), strict=True):
                at, centre = (_exact_cycles(SHORT, index, scatterer, t, False) for t in (time_s, 0.0))
                exact += mp.re(w * mp.expjpi(2 * sign * (at - centre)))
            assert abs(mpf(float(ours[n])) - exact) < 3e-9


def _beats(
    segment: Segment, range_m: float, speed_mps: float, acceleration_mps2: float
) -> tuple[float, float]:
    """Signed beat frequency at the record's centre, and its rate, to leading order."""
    slope = abs(segment.slope_hz_per_s)
    per_speed = 2.0 / SPEED_OF_LIGHT_MPS
    beat_hz = slope * per_speed * range_m
    optical_hz = segment.start_frequency_hz + segment.slope_hz_per_s * segment.start_to_centre_s
    migration = -2 * slope * per_speed * speed_mps
    smear = per_speed * optical_hz * acceleration_mps2
    if segment.slope_hz_per_s > 0:
        return beat_hz - (optical_hz - beat_hz) * per_speed * speed_mps, migration - smear
    return beat_hz + (optical_hz + beat_hz) * per_speed * speed_mps, migration * (slope > 0) + smear


@pytest.mark.parametrize("index", [0, 1, 2], ids=["up", "constant", "down"])
@pytest.mark.parametrize("acceleration_mps2", [0.0, 3.0, -100.0])
def test_phase_is_that_of_the_beat_and_its_rate(index: int, acceleration_mps2: float) -> None:
    segment = frequency_plan(SHORT)[index]
    scatterer = (2164.784, 92.388, acceleration_mps2)
    time_s = record_times(SHORT)
    beat_hz, rate_hz_per_s = _beats(segment, *scatterer)
    expected = beat_hz * time_s + 0.5 * rate_hz_per_s * time_s**2
    ours = segment.beat_sign * phase_cycles(segment, *scatterer, time_s, False)
    # What is left is cubic, 6 S a x³ / c: 5e-6 cycles at 100 m/s²; and S R / f_c of the smear, 1e-7 of it.
    assert abs(ours - expected).max() < 1e-7 + 1e-6 * abs(acceleration_mps2)
    assert abs(ours - beat_hz * time_s).max() > 1e-3 or (index == 1 and acceleration_mps2 == 0.0)


def test_plan_has_no_jump() -> None:
    waveform = Waveform(slope_error=0.01)
    up, constant, down = frequency_plan(waveform)
    lasts = waveform.segment_time_s
    ends = [s.start_frequency_hz + s.slope_hz_per_s * lasts for s in (up, constant, down)]
    np.testing.assert_allclose(
        ends, [constant.start_frequency_hz, down.start_frequency_hz, up.start_frequency_hz], rtol=1e-15
    )
    for before, here in ((down, up), (up, constant), (constant, down)):
        assert here.previous_slope_hz_per_s == before.slope_hz_per_s
    assert [s.centre_s for s in (up, constant, down)] == [-lasts, 0.0, lasts]


@pytest.mark.parametrize("index", [0, 1, 2], ids=["up", "constant", "down"])
@pytest.mark.parametrize("excess", [-0.1, 0.0, 0.3])
def test_beyond_the_record_edge_the_line_loses_its_share(index: int, excess: float) -> None:
    waveform = Waveform(fft_length=4096, sample_rate_hz=600e6 / 32)
    late_s = excess * waveform.record_time_s
    range_m = waveform.record_edge_range_m + SPEED_OF_LIGHT_MPS / 2 * late_s
    beamlets = Beamlets(np.array([range_m]), np.zeros(1), 0.0, np.ones(1, dtype=complex))
    segment = frequency_plan(waveform)[index]
    with_edges = analytic_record(waveform, segment, beamlets, edges=True).real
    without = analytic_record(waveform, segment, beamlets).real
    late = record_times(waveform) < late_s - waveform.record_time_s / 2
    # The edge lies between two samples that may both be near it.
    unlike = abs(with_edges - without) > 1e-6
    assert not unlike[~late].any()
    if excess > 0:
        assert unlike.mean() > 0.9 * excess
