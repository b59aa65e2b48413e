"""The two estimators on exact and rounded frequencies, against the truth that made them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from lidar_emu.fmcw.estimate import Estimate, chirp_minus_doppler, least_squares

LENGTH = 2.0**17
FARTHEST = 35_600.0
TWELFTH = 1 / 12


def _observed(beat: float, doppler: float) -> np.ndarray:
    """Where a real record shows up-chirp, constant segment and down-chirp."""
    signed = np.array([beat - doppler, doppler, beat + doppler])
    return np.abs(signed - LENGTH * np.round(signed / LENGTH))


@settings(deadline=None)
@given(beat=st.floats(5, FARTHEST), doppler=st.floats(-60_000, 60_000))
def test_published_detector_finds_what_does_not_fold_at_nyquist(beat: float, doppler: float) -> None:
    assume(beat + abs(doppler) < LENGTH / 2)
    assume(min(beat, abs(doppler)) > 4)
    estimate = chirp_minus_doppler(*_observed(beat, doppler), TWELFTH, TWELFTH, TWELFTH)
    assert estimate.range_bin == pytest.approx(beat, abs=1e-6)
    assert estimate.doppler_bin == pytest.approx(doppler, abs=1e-6)
    assert estimate.residual_bin == pytest.approx(0, abs=1e-6)
    assert estimate.sign_resolved
    assert estimate.range_variance == pytest.approx(2 / 12)
    assert estimate.doppler_variance == pytest.approx(1 / 12)


def test_published_detector_errs_beyond_nyquist_and_its_residual_says_so() -> None:
    estimate = chirp_minus_doppler(*_observed(14_000, 60_000), TWELFTH, TWELFTH, TWELFTH)
    assert abs(estimate.range_bin - 14_000) > 1000
    assert abs(estimate.residual_bin) > 1000


def _least_squares(
    observed: np.ndarray, variances: tuple[float, float, float] = (TWELFTH, TWELFTH, TWELFTH)
) -> Estimate:
    return least_squares(*observed, *variances, LENGTH, FARTHEST)


@settings(deadline=None)
@given(beat=st.floats(5, FARTHEST), doppler=st.floats(-65_000, 65_000))
def test_least_squares_is_right_wherever_it_says_that_the_sign_is_resolved(
    beat: float, doppler: float
) -> None:
    estimate = _least_squares(np.rint(_observed(beat, doppler)))
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


@pytest.mark.parametrize("doppler", [500.0, -500.0])
def test_sign_is_not_resolved_at_the_ground(doppler: float) -> None:
    """At no range the mirror image, negative range and opposite speed, fits as well."""
    assert not _least_squares(_observed(0.0, doppler)).sign_resolved
    assert _least_squares(_observed(0.0, doppler)).doppler_bin == 500.0  # of equals the closing one
    assert not chirp_minus_doppler(*_observed(0.0, doppler), TWELFTH, TWELFTH, TWELFTH).sign_resolved


def test_a_false_lock_is_not_resolved() -> None:
    """One chirp locked on noise: the residual is gross, and so nothing is beyond doubt."""
    observed = _observed(5000.0, 2000.0) + np.array([0.0, 0.0, 12_345.0])
    estimate = _least_squares(observed)
    assert abs(estimate.residual_bin) > 100
    assert not estimate.sign_resolved


def test_frequencies_that_nothing_explains_are_not_found() -> None:
    far_beyond = np.array([60_000.0, 50.0, 100.0])
    estimate = least_squares(*far_beyond, TWELFTH, TWELFTH, TWELFTH, LENGTH, 100.0)
    assert not estimate.found
    assert np.isnan(estimate.range_bin)
