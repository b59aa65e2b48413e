"""Errors of whole flights over their stated sigma, in the table of docs/evidence/accuracy.md."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import flight_sigma

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("quantised", [True, False])
def test_sigma_covers_a_flight_without_its_systematic_errors(quantised: bool) -> None:
    name = "descent.yaml" if quantised else "descent.yaml, `ndl_fine`"
    scores = flight_sigma.flight_scores(*flight_sigma.FLIGHTS[name])
    if quantised:
        assert scores.root_mean_square == pytest.approx(1.0, abs=0.1)
        assert (scores.beyond_three < 0.003).all()
    else:
        assert scores.robust == pytest.approx(1.0, abs=0.1)
        assert (scores.beyond_three < (0.03, 0.06)).all()
        # The errors of deceleration and closing speed are no part of sigma.
        assert scores.systematic[0] > 5.0
    whole = np.hypot(scores.root_mean_square, scores.systematic)
    assert scores.whole == pytest.approx(whole, rel=0.06)


def test_the_page_has_these_flights() -> None:
    page = (ROOT / "docs" / "evidence" / "accuracy.md").read_text()
    for name in flight_sigma.FLIGHTS:
        assert page.count(f"| {name} | ") >= 2
