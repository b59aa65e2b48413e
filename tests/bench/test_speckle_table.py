"""The fast levels against the reference's figures in evidence/accuracy.md, from 20 m to 5 km and from hover to spin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import speckle_table

ROOT = Path(__file__).resolve().parents[2]
SHOTS = 1000


def committed_reference() -> dict[str, np.ndarray]:
    """Range mm, speed mm/s, means in per cent, valid and false shares in per cent, of each scene."""
    page = (ROOT / "docs" / "evidence" / "accuracy.md").read_text()
    table = page.split("<!-- speckle: begin -->")[1].split("<!-- speckle: end -->")[0]
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if "|" in line
    ]
    return {row[0]: np.array(row[2:8], dtype=float) for row in rows if row[1] == "reference"}


def test_the_table_has_all_scenes() -> None:
    assert list(committed_reference()) == [str(scene) for scene in speckle_table.SCENES]


@pytest.mark.slow
@pytest.mark.parametrize("level", [name for name in speckle_table.FAST_LEVELS if "exact" not in name])
@pytest.mark.parametrize("row", range(len(committed_reference())))
def test_levels_follow_the_reference(row: int, level: str) -> None:
    """Before lines of spinning beams were right, deviations were twice or half of the reference's."""
    scene = speckle_table.SCENES[row]
    range_mm, speed_mmps, *_, valid, false = committed_reference()[str(scene)]
    scores = speckle_table.score(scene, speckle_table.measure(scene, speckle_table.FAST_LEVELS[level], SHOTS))
    for found, reference in zip(scores.deviations, (1e-3 * range_mm, 1e-3 * speed_mmps), strict=True):
        # The reference's error, of twice as many measurements, is in the page's rounding and half of this one's.
        assert abs(found.value - reference) < 0.05 * reference + 3.0 * 1.25 * found.error
    for share, percent in (scores.valid, valid), (scores.false, false):
        assert abs(share.value - 0.01 * percent) < 0.01 + 3.0 * 1.25 * share.error


def test_allowed_differences() -> None:
    """5 % of a deviation and three errors of both; a miss is in bold."""
    one, other = speckle_table.Figure(1.11, 0.012), speckle_table.Figure(1.0, 0.016)
    assert one.over_allowed(other, 0.05 * other.value) == pytest.approx(0.11 / (0.05 + 3 * 0.02))
    assert speckle_table._judged("1.1", 1.2) == "**1.1 (1.2)**"
    assert speckle_table._judged("1.1", 0.94) == "1.1 (0.9)"


def test_statistics_of_known_errors() -> None:
    """Normal errors about a mean of half a deviation, a twentieth invalid and a tenth false."""
    rng = np.random.default_rng(3)
    count = 4000
    range_m = 0.02 * (rng.standard_normal(count) + 0.5)
    range_m[: count // 10] = 100.0
    valid = np.arange(count) < 0.95 * count
    errors = speckle_table.Errors(range_m, 1e-4 * rng.standard_normal(count), valid)
    scores = speckle_table.score(speckle_table.SCENES[0], errors)
    assert scores.deviations[0].value == pytest.approx(0.02, rel=0.06)
    # 1.17/√n is the error of a robust deviation.
    assert scores.deviations[0].error == pytest.approx(0.02 * 1.17 / np.sqrt(0.85 * count), rel=0.3)
    assert scores.means[0].value == pytest.approx(0.5, abs=0.07)
    assert scores.valid.value == pytest.approx(0.95)
    assert scores.false.value == pytest.approx(0.1)
