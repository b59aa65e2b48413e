"""The fast levels against the reference's figures in evidence/accuracy.md, from 20 m to 5 km and from hover to spin."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
SHOTS = 1000


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "tools"))
        return importlib.import_module("speckle_table")


def committed_reference() -> dict[str, np.ndarray]:
    """Range mm, speed mm/s, means in per cent, valid and false shares in per cent, of each scene."""
    page = (ROOT / "docs" / "evidence" / "accuracy.md").read_text()
    table = page.split("<!-- speckle: begin -->")[1].split("<!-- speckle: end -->")[0]
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if "|" in line
    ]
    return {row[0]: np.array(row[2:8], dtype=float) for row in rows if row[1] == "reference"}


def test_the_table_has_all_scenes(tool: ModuleType) -> None:
    assert list(committed_reference()) == [str(scene) for scene in tool.SCENES]


@pytest.mark.slow
@pytest.mark.parametrize("level", ["default", "statistical"])
@pytest.mark.parametrize("row", range(len(committed_reference())))
def test_levels_follow_the_reference(row: int, level: str, tool: ModuleType) -> None:
    """Before lines of spinning beams were right, deviations were twice or half of the reference's."""
    scene = tool.SCENES[row]
    range_mm, speed_mmps, *_, valid, false = committed_reference()[str(scene)]
    scores = tool.score(scene, tool.measure(scene, tool.FAST_LEVELS[level], SHOTS))
    for found, reference in zip(scores.deviations, (1e-3 * range_mm, 1e-3 * speed_mmps), strict=True):
        # The reference's error, of twice as many measurements, is in the page's rounding and half of this one's.
        assert abs(found.value - reference) < 0.05 * reference + 3.0 * 1.25 * found.error
    for share, percent in (scores.valid, valid), (scores.false, false):
        assert abs(share.value - 0.01 * percent) < 0.01 + 3.0 * 1.25 * share.error


def test_allowed_differences(tool: ModuleType) -> None:
    """5 % of a deviation and three errors of both; a miss is in bold."""
    one, other = tool.Figure(1.11, 0.012), tool.Figure(1.0, 0.016)
    assert one.over_allowed(other, 0.05 * other.value) == pytest.approx(0.11 / (0.05 + 3 * 0.02))
    assert tool._judged("1.1", 1.2) == "**1.1 (1.2)**"
    assert tool._judged("1.1", 0.94) == "1.1 (0.9)"


def test_statistics_of_known_errors(tool: ModuleType) -> None:
    """Normal errors about a mean of half a deviation, a twentieth invalid and a tenth false."""
    rng = np.random.default_rng(3)
    count = 4000
    range_m = 0.02 * (rng.standard_normal(count) + 0.5)
    range_m[: count // 10] = 100.0
    valid = np.arange(count) < 0.95 * count
    errors = tool.Errors(range_m, 1e-4 * rng.standard_normal(count), valid)
    scores = tool.score(tool.SCENES[0], errors)
    assert scores.deviations[0].value == pytest.approx(0.02, rel=0.06)
    # 1.17/√n is the error of a robust deviation.
    assert scores.deviations[0].error == pytest.approx(0.02 * 1.17 / np.sqrt(0.85 * count), rel=0.3)
    assert scores.means[0].value == pytest.approx(0.5, abs=0.07)
    assert scores.valid.value == pytest.approx(0.95)
    assert scores.false.value == pytest.approx(0.1)
