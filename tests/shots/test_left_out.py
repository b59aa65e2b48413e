"""What is left out of a beam's measurement changes it by less than the plan says, and not at all beyond the limit."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lidar_emu.plan.receiver import LINE_BOUND_POWER, SMEAR_BOUND, largest_smear_bins
from lidar_emu.receiver.motion_smear import smear_taps
from lidar_emu.receiver.receiver import receive
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.returns import Echoes, Returns
from lidar_emu.receiver.skip_limits import LEAST_LINE_DRIFT, LEAST_SMEAR_BINS
from lidar_emu.scenario.instrument import Detection, Instrument, Waveform

SHOTS = 64
RECORD_S = 2**17 / 600e6
LEFT_OUT_BIN2 = (1.05**2 - 1) / 3 * 3.24 * 0.3898**2 / 1e5
"""What each stage may leave out of a beat's variance: a third of 5 % of sigma, for the estimator's noise at 50 dB."""
FINE = Detection(peak="hann", combine="least_squares")


def _echoes(
    range_m: float, speed_mps: float, acceleration_mps2: float, slope: float, beamlets: int, seed: int
) -> Echoes:
    """One beam on a slope, shot after shot on new ground, 50 dB above the noise."""
    rng = np.random.default_rng(seed)
    across_m = 0.02 * rng.normal(size=(SHOTS, 1, beamlets)) if beamlets > 1 else np.zeros((SHOTS, 1, 1))
    one = np.ones((SHOTS, 1))
    model = build_receiver(Instrument())
    return Echoes(
        range_m=range_m + slope * across_m,
        closing_speed_mps=speed_mps + 0.02 * across_m,
        power_w=np.full_like(across_m, 1e5 / model.snr_per_w / beamlets),
        range_rate_mps=np.full_like(across_m, -speed_mps),
        closing_acceleration_mps2=acceleration_mps2 * one,
        closing_jerk_mps3=0 * one,
        range_curvature_mps2=0 * one,
        air_speed_mps=speed_mps * one,
        speckle_place=np.zeros((SHOTS, 1, 6)),
        speckle_motion=np.full((SHOTS, 1, 3), (283.0, 0.0, 0.0)),
        fired=one == 1,
        inside=one == 0,
    )


def _with_and_without(instrument: Instrument, echoes: Echoes) -> tuple[Returns, Returns]:
    shot = np.arange(SHOTS)
    return tuple(
        receive(build_receiver(instrument, left_out_share=share), echoes, shot, 7) for share in (0.05, 0.0)
    )  # type: ignore[return-value]


def _power_differs_by(some: Returns, whole: Returns) -> float:
    """Largest relative difference of the peaks' power, where both saw the echo in all segments."""
    both = (some.segments == 7) & (whole.segments == 7)
    return float(np.max(np.abs(10 ** ((some.snr_db - whole.snr_db)[both] / 10) - 1), initial=0.0))


def _same(some: Returns, whole: Returns) -> bool:
    return all(
        np.array_equal(getattr(some, f.name), getattr(whole, f.name), equal_nan=f.name != "reason")
        for f in fields(Returns)
    )


SKIPPED = {"smear": 0, "line": 0, "all": 0}


@settings(max_examples=60)
@given(
    range_m=st.floats(5, 3000),
    speed_mps=st.floats(-60, 60),
    acceleration_mps2=st.floats(-2, 2),
    slope=st.floats(0, 1),
    beamlets=st.sampled_from([1, 7]),
    linewidth_hz=st.sampled_from([0.0, 30.0, 300.0, 3e3]),
    seed=st.integers(0, 2**32 - 1),
)
@example(5.0, 0.0, 1.0, 0.0, 7, 3e3, 0)
def _compare(range_m, speed_mps, acceleration_mps2, slope, beamlets, linewidth_hz, seed) -> None:
    instrument = Instrument(waveform=Waveform(linewidth_hz=linewidth_hz), detection=FINE)
    echoes = _echoes(range_m, speed_mps, acceleration_mps2, slope, beamlets, seed)
    some, whole = _with_and_without(instrument, echoes)
    record_s = instrument.waveform.record_time_s
    by_motion = 2 * acceleration_mps2 / 1550e-9 * record_s**2
    by_migration = 4 * 2e12 * speed_mps / 299792458 * record_s**2
    smear_bins = np.abs([by_migration + by_motion, by_motion, by_migration - by_motion])
    assert largest_smear_bins(instrument.waveform, echoes) == pytest.approx(smear_bins.max(), abs=1e-4)
    smeared = smear_bins.min() <= LEAST_SMEAR_BINS
    drift = 4 * np.pi * linewidth_hz * range_m / 299792458
    line_bin2 = 3.24 * 3 * drift**2 / (2 * np.pi**3 * linewidth_hz * RECORD_S) if linewidth_hz else 0.0
    lined = 0 < drift <= LEAST_LINE_DRIFT and line_bin2 <= LEFT_OUT_BIN2
    SKIPPED["all"] += 1
    SKIPPED["smear"] += smeared
    SKIPPED["line"] += lined
    bound = 1.0 - (1.0 - SMEAR_BOUND * smeared) ** 2 + LINE_BOUND_POWER * lined
    # The line's numbers are smeared at left_out_share 0 alone: the amplitudes of a weak smear beside its centre sum to
    # half of it, and the line's to three times their deviation.
    bound += 3.0 * smear_bins.max() * np.sqrt(drift * 2 * range_m / 299792458 / RECORD_S)
    assert _power_differs_by(some, whole) <= bound
    if beamlets == 1:
        moved = np.abs(some.segment_peak_hz - whole.segment_peak_hz) / instrument.waveform.bin_width_hz
        # Of speckle within the record, too: in fades the peaks of both move by more.
        assert np.nanmedian(moved) <= SMEAR_BOUND * smeared + 2 * np.sqrt(LEFT_OUT_BIN2)


def test_random_scenes_stay_below_the_bounds_and_many_leave_something_out() -> None:
    SKIPPED.update(smear=0, line=0, all=0)
    _compare()
    assert SKIPPED["smear"] + SKIPPED["line"] >= 0.3 * SKIPPED["all"]


def test_smear_bound_is_what_the_filter_left_out_has_beside_its_centre() -> None:
    taps = np.empty((2, 17), dtype=np.float32)
    smear_taps(LEAST_SMEAR_BINS, 8, taps)
    beside = np.abs(taps[0] + 1j * taps[1])[[7, 9]]
    assert np.max(beside) <= SMEAR_BOUND <= 1.1 * np.max(beside)


@pytest.mark.parametrize("side", [0.98, 1.02])
def test_smear_has_two_sides(side: float) -> None:
    instrument = Instrument(waveform=Waveform(linewidth_hz=0), detection=FINE)
    waveform = instrument.waveform
    acceleration_mps2 = side * LEAST_SMEAR_BINS * waveform.wavelength_m / 2 / waveform.record_time_s**2
    echoes = _echoes(800.0, 0.0, acceleration_mps2, 0.0, 1, 3)
    assert _same(*_with_and_without(instrument, echoes)) is (side > 1)


@pytest.mark.parametrize("side", [0.98, 1.02])
def test_the_line_has_two_sides(side: float) -> None:
    range_m = side * LEAST_LINE_DRIFT * 299792458 / (4 * np.pi * 3e3)
    echoes = _echoes(range_m, 0.0, 0.0, 0.0, 1, 3)._replace(closing_speed_mps=np.full((SHOTS, 1, 1), 50.0))
    # Faint enough that the line's scatter does not matter, and without a change of speckle.
    echoes = echoes._replace(power_w=1e-3 * echoes.power_w, speckle_motion=np.zeros((SHOTS, 1, 3)))
    # Migration at this speed is beyond its own limit.
    some, whole = _with_and_without(Instrument(detection=FINE), echoes)
    # With the line in both, its numbers are smeared in one of them.
    assert (_power_differs_by(some, whole) < 0.1 * LINE_BOUND_POWER) is (side > 1)


def test_bounds_are_no_looser_than_ten_times_what_is_seen() -> None:
    """Just within the limits, where the difference is largest."""
    worst_power = worst_bins = 0.0
    for seed in range(8):
        range_m = 0.99 * LEAST_LINE_DRIFT * 299792458 / (4 * np.pi * 3e3)
        echoes = _echoes(range_m, 50.0, 0.0, 0.0, 1, seed)
        # Faint enough that the line's scatter does not matter.
        echoes = echoes._replace(power_w=1e-3 * echoes.power_w, speckle_motion=np.zeros((SHOTS, 1, 3)))
        some, whole = _with_and_without(Instrument(detection=FINE), echoes)
        worst_power = max(worst_power, _power_differs_by(some, whole))
        moved = np.abs(some.segment_peak_hz - whole.segment_peak_hz) / Waveform().bin_width_hz
        worst_bins = max(worst_bins, float(np.nanmedian(moved)))
    assert worst_power <= 2 * LINE_BOUND_POWER <= 20 * worst_power
    limit_bins = np.sqrt(1e3 * LEFT_OUT_BIN2)
    assert worst_bins <= limit_bins <= 10 * worst_bins
