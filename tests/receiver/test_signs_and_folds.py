"""The two estimators on exact and rounded frequencies, against the truth that made them."""

from __future__ import annotations

from itertools import product
from typing import get_args

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from instruments import targets

from lidar_emu.receiver.range_speed_estimation import (
    ALL,
    COMBINE_METHODS,
    CONSTANT,
    DOWN,
    UP,
    Estimate,
    chirp_minus_doppler,
    estimate_range_speed,
    least_squares,
)
from lidar_emu.scenario.instrument import Detection

LENGTH = 2.0**17
FARTHEST = 35_600.0
TWELFTH = 1 / 12
PAIRS = [UP | CONSTANT, UP | DOWN, CONSTANT | DOWN]


def _observed(beat: float, doppler: float) -> np.ndarray:
    """Where a real record shows up-chirp, constant segment and down-chirp."""
    signed = np.array([beat - doppler, doppler, beat + doppler])
    return np.abs(signed - LENGTH * np.round(signed / LENGTH))


def test_methods_are_those_of_the_scenario() -> None:
    assert set(COMBINE_METHODS) == set(get_args(Detection.model_fields["combine"].annotation))


@settings(deadline=None)
@given(beat=st.floats(5, FARTHEST), doppler=st.floats(-60_000, 60_000))
def test_published_detector_finds_what_does_not_fold_at_nyquist(beat: float, doppler: float) -> None:
    assume(beat + abs(doppler) < LENGTH / 2)
    assume(min(beat, abs(doppler)) > 4)
    estimate = chirp_minus_doppler(targets(_observed(beat, doppler)), LENGTH, FARTHEST)
    assert estimate.range_bin == pytest.approx(beat, abs=1e-6)
    assert estimate.doppler_bin == pytest.approx(doppler, abs=1e-6)
    assert estimate.residual_bin == pytest.approx(0, abs=1e-6)
    assert estimate.sign_resolved
    assert estimate.range_variance == pytest.approx(2 / 12)
    assert estimate.doppler_variance == pytest.approx(1 / 12)


def test_published_detector_errs_beyond_nyquist_and_its_residual_states_so() -> None:
    estimate = chirp_minus_doppler(targets(_observed(14_000, 60_000)), LENGTH, FARTHEST)
    assert abs(estimate.range_bin - 14_000) > 1000
    assert abs(estimate.residual_bin) > 1000


def _least_squares(
    observed: np.ndarray, variances: tuple[float, float, float] = (TWELFTH, TWELFTH, TWELFTH)
) -> Estimate:
    return least_squares(ALL, targets(observed, variances), LENGTH, FARTHEST)


@settings(deadline=None)
@given(beat=st.floats(0, FARTHEST), doppler=st.floats(-65_000, 65_000))
def test_least_squares_is_right_wherever_it_states_that_the_sign_is_resolved(
    beat: float, doppler: float
) -> None:
    estimate = _least_squares(np.rint(_observed(beat, doppler)))
    assert estimate.found
    if estimate.sign_resolved:
        assert abs(estimate.range_bin - beat) <= 1
        assert abs(estimate.doppler_bin - doppler) <= 1
        assert abs(estimate.residual_bin) <= 2


def test_least_squares_resolves_nearly_everything_folds_included() -> None:
    rng = np.random.default_rng(4)
    beat, doppler = rng.uniform(10, FARTHEST, 4000), rng.uniform(-65_000, 65_000, 4000)
    estimates = [_least_squares(np.rint(_observed(b, d))) for b, d in zip(beat, doppler, strict=True)]
    right = np.array([abs(e.range_bin - b) <= 1 for e, b in zip(estimates, beat, strict=True)])
    resolved = np.array([e.sign_resolved for e in estimates])
    assert right.mean() > 0.999
    assert resolved.mean() > 0.995
    assert right[resolved].all()
    assert (beat + abs(doppler) > LENGTH / 2).mean() > 0.2


@settings(deadline=None)
@given(
    beat=st.floats(100, FARTHEST),
    doppler=st.floats(-30_000, 30_000),
    errors=st.tuples(*[st.floats(-0.5, 0.5)] * 3),
    variances=st.tuples(*[st.floats(1e-3, 0.2)] * 3),
)
def test_least_squares_is_the_weighted_solution(
    beat: float, doppler: float, errors: tuple[float, ...], variances: tuple[float, float, float]
) -> None:
    assume(abs(doppler) > 100)
    assume(abs(beat - abs(doppler)) > 100)
    signed = np.array([beat - doppler, doppler, beat + doppler]) + errors
    assume(np.abs(signed).max() < LENGTH / 2)
    estimate = _least_squares(np.abs(signed), variances)
    design = np.array([[1.0, -1.0], [0.0, 1.0], [1.0, 1.0]])
    weights = np.diag(1 / np.array(variances))
    covariance = np.linalg.inv(design.T @ weights @ design)
    solution = covariance @ design.T @ weights @ signed
    assume(abs(estimate.range_bin - beat) < 2)  # a coincidence of folds may fit large errors better
    assert [estimate.range_bin, estimate.doppler_bin] == pytest.approx(solution, abs=1e-6)
    assert [estimate.range_variance, estimate.doppler_variance] == pytest.approx(
        np.diag(covariance), rel=1e-9
    )
    assert estimate.residual_bin == pytest.approx(signed[2] - signed[0] - 2 * signed[1], abs=1e-6)


SHORT = 256.0


@pytest.mark.parametrize("method", COMBINE_METHODS)
@pytest.mark.parametrize("mask", [ALL, *PAIRS])
@settings(deadline=None, max_examples=400)
@given(data=st.data())
def test_what_is_resolved_is_the_truth(method: str, mask: int, data: st.DataObject) -> None:
    """Records of 256 samples, in which coincidences of folds are common, and ranges up to twice the sample rate."""
    if mask != ALL and method != "least_squares":
        return
    farthest = data.draw(st.integers(4, int(2 * SHORT)))
    beat, doppler = data.draw(st.integers(0, farthest)), data.draw(st.integers(-127, 127))
    signed = np.array([beat - doppler, doppler, beat + doppler])
    observed = np.abs(signed - SHORT * np.round(signed / SHORT))
    estimate = estimate_range_speed(COMBINE_METHODS[method], mask, targets(observed), SHORT, float(farthest))
    if estimate.sign_resolved:
        assert abs(estimate.range_bin - beat) <= 2.5
        assert abs(estimate.doppler_bin - doppler) <= 2.5


@pytest.mark.parametrize("method", COMBINE_METHODS)
def test_a_range_beyond_nyquist_is_not_resolved(method: str) -> None:
    """20 MS/s and 2 MHz/µs: 1300 m, 17 345 kHz, reads as 199 m, 2655 kHz, with the opposite speed."""
    length, range_bin_m = 4096.0, 0.36597
    observed = np.abs(np.array([1300 / range_bin_m - 300, 300, 1300 / range_bin_m + 300 - 4096]))
    observed[0] = length - observed[0]
    estimate = estimate_range_speed(
        COMBINE_METHODS[method], ALL, targets(observed), length, 12_200 / range_bin_m
    )
    assert estimate.range_bin * range_bin_m == pytest.approx(199, abs=1)
    assert not estimate.sign_resolved
    # In an instrument that cannot hear it there is no doubt.
    near = estimate_range_speed(COMBINE_METHODS[method], ALL, targets(observed), length, 700 / range_bin_m)
    assert near.sign_resolved


@pytest.mark.parametrize("doppler", [500.0, -500.0])
def test_sign_is_not_resolved_at_the_ground(doppler: float) -> None:
    """At no range the mirror image, negative range and opposite speed, fits as well."""
    assert not _least_squares(_observed(0.0, doppler)).sign_resolved
    assert _least_squares(_observed(0.0, doppler)).doppler_bin == 500.0  # of equals the closing one
    assert not chirp_minus_doppler(targets(_observed(0.0, doppler)), LENGTH, FARTHEST).sign_resolved


def test_a_false_lock_is_not_resolved() -> None:
    """One chirp locked on noise: the residual is gross, and so nothing is beyond doubt."""
    observed = _observed(5000.0, 2000.0) + np.array([0.0, 0.0, 12_345.0])
    estimate = _least_squares(observed)
    assert abs(estimate.residual_bin) > 100
    assert not estimate.sign_resolved


def test_frequencies_that_nothing_explains_are_not_found() -> None:
    far_beyond = np.array([60_000.0, 50.0, 100.0])
    estimate = least_squares(ALL, targets(far_beyond), LENGTH, 100.0)
    assert not estimate.found
    assert np.isnan(estimate.range_bin)
    assert not estimate.sign_resolved


RANGE_BIN_M, SPEED_BIN_MPS = 0.343085, 3.547668e-3


def _of_two(mask: int, observed: np.ndarray, farthest: float = FARTHEST) -> Estimate:
    """Least squares that would show if the missing segment's frequency or variance were read."""
    there = [bool(mask & bit) for bit in (UP, CONSTANT, DOWN)]
    frequencies = np.where(there, observed, np.nan)
    variances = np.where(there, TWELFTH, np.nan)
    return least_squares(mask, targets(frequencies, variances), LENGTH, farthest)


@pytest.mark.parametrize("mask", PAIRS)
def test_two_segments_admit_ranges_to_three_standard_deviations(mask: int) -> None:
    observed = _observed(1000.0, 3000.0)
    sigma = np.sqrt(_of_two(mask, observed).range_variance)
    assert _of_two(mask, observed, 1000.0 - 2.9 * sigma).range_bin == pytest.approx(1000.0)
    assert _of_two(mask, observed, 1000.0 - 3.1 * sigma).range_bin != pytest.approx(1000.0)


def _slow_explanations(mask: int, observed: np.ndarray) -> list[tuple[int, bool, bool, bool, float, float]]:
    """All explanations, best first: folds, receding, third segment audible, b not below |d|; b and d."""
    signs = [(1, 0), (-1, 0), (-1, 1), (1, -1)]  # of F, and how many N come with it
    explanations = []
    for choices in product(signs, signs):
        segments = [s for s in range(3) if mask & (1 << s)]
        if any(s == 1 and folds for s, (_, folds) in zip(segments, choices, strict=True)):
            continue
        signed = {s: sign * observed[s] + n * LENGTH for s, (sign, n) in zip(segments, choices, strict=True)}
        if 1 not in signed:
            signed[1] = (signed[2] - signed[0]) / 2
            silent = signed[1]
        elif 2 not in signed:
            silent = signed[2] = signed[0] + 2 * signed[1]
        else:
            silent = signed[0] = signed[2] - 2 * signed[1]
        beat, doppler = (signed[0] + signed[2]) / 2, signed[1]
        slack = 3 * np.sqrt(TWELFTH / 2 if mask == UP | DOWN else TWELFTH * 2)
        if -slack <= beat <= FARTHEST + slack and abs(doppler) <= LENGTH / 2:
            folds = sum(n != 0 for _, n in choices)
            explanations.append((folds, doppler < 0, abs(silent) > 16, abs(doppler) <= beat, beat, doppler))
    return sorted(explanations, key=lambda e: e[:4])


@settings(deadline=None)
@given(mask=st.sampled_from(PAIRS), range_m=st.floats(0, 12_000), speed_mps=st.floats(-230, 230))
def test_two_segments_admit_the_truth_and_choose_the_likeliest(
    mask: int, range_m: float, speed_mps: float
) -> None:
    beat, doppler = range_m / RANGE_BIN_M, speed_mps / SPEED_BIN_MPS
    observed = np.rint(_observed(beat, doppler))
    explanations = _slow_explanations(mask, observed)
    assert any(abs(e[4] - beat) <= 1 and abs(e[5] - doppler) <= 1 for e in explanations)
    estimate = _of_two(mask, observed)
    assert estimate.found
    assert np.isnan(estimate.residual_bin)
    same_rank = [e for e in explanations if e[:4] == explanations[0][:4]]
    assert (estimate.range_bin, estimate.doppler_bin) in [e[4:] for e in same_rank]
    if estimate.sign_resolved:  # then nothing else is admitted but what lies within six standard deviations
        assert abs(estimate.range_bin - beat) <= 1 + 6 * np.sqrt(estimate.range_variance)
        assert abs(estimate.doppler_bin - doppler) <= 1 + 6 * np.sqrt(estimate.doppler_variance)


@pytest.mark.parametrize("doppler", [-10.0, 0.0, 10.0])
def test_chirps_without_doppler_line_are_a_hover(doppler: float) -> None:
    estimate = _of_two(UP | DOWN, _observed(3000.0, doppler))
    assert estimate.range_bin == 3000.0
    assert estimate.doppler_bin == doppler
    assert not estimate.sign_resolved


@pytest.mark.parametrize(
    ("mask", "range_variance", "doppler_variance"),
    [(UP | DOWN, (0.1 + 0.3) / 4, (0.1 + 0.3) / 4), (UP | CONSTANT, 0.3, 0.2), (CONSTANT | DOWN, 0.5, 0.2)],
)
def test_variances_of_two_segments(mask: int, range_variance: float, doppler_variance: float) -> None:
    estimate = least_squares(mask, targets(_observed(2000.0, 9000.0), (0.1, 0.2, 0.3)), LENGTH, FARTHEST)
    assert [estimate.range_variance, estimate.doppler_variance] == pytest.approx(
        [range_variance, doppler_variance]
    )


def test_one_explanation_alone_is_resolved() -> None:
    """As far as the instrument goes: what lies beyond is no rival."""
    observed = _observed(9000.0, 20_000.0)
    assert not _of_two(UP | CONSTANT, observed).sign_resolved
    estimate = _of_two(UP | CONSTANT, observed, farthest=9500.0)
    assert estimate.sign_resolved
    assert (estimate.range_bin, estimate.doppler_bin) == (9000.0, 20_000.0)


@pytest.mark.parametrize("mask", [0, UP, CONSTANT, DOWN])
def test_fewer_than_two_segments_say_nothing(mask: int) -> None:
    estimate = least_squares(mask, targets((1.0, 2.0, 3.0)), LENGTH, FARTHEST)
    assert not estimate.found
    assert not estimate.sign_resolved
    assert np.isnan([estimate.range_bin, estimate.doppler_bin]).all()


EXTREME = st.sampled_from([0.0, 1e-300, 1.0, 65_535.5, 65_536.0, 1e9, 1e150, np.inf, np.nan])


@settings(deadline=None, max_examples=300)
@given(
    mask=st.sampled_from([*PAIRS, ALL]),
    observed=st.tuples(EXTREME, EXTREME, EXTREME),
    variances=st.tuples(EXTREME, EXTREME, EXTREME),
    farthest=st.sampled_from([0.0, 1.0, FARTHEST]),
)
def test_what_is_found_is_finite(
    mask: int, observed: tuple[float, ...], variances: tuple[float, ...], farthest: float
) -> None:
    estimate = least_squares(mask, targets(observed, variances), LENGTH, farthest)
    if estimate.found:
        assert np.isfinite([estimate.range_bin, estimate.doppler_bin]).all()
        assert np.isfinite([estimate.range_variance, estimate.doppler_variance]).all()
        assert np.isnan(estimate.residual_bin) == (mask != ALL)
    else:
        assert not estimate.sign_resolved
