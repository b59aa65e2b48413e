"""Published laws by others, in short form; the page's table has the long one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import lidar_emu
from benchmarks import published_laws as laws
from benchmarks import published_rows
from benchmarks.speckle_table import Figure

PAGE = (Path(published_rows.__file__).parents[1] / "docs" / "evidence" / "published.md").read_text()


def test_the_page_has_all_rows_and_their_sources() -> None:
    table = PAGE.split("<!-- published: begin -->")[1].split("<!-- published: end -->")[0]
    rows = [line.strip("| ").split(" | ") for line in table.splitlines() if line.startswith("| ")]
    named = [row[:2] for row in rows[1:] if len(row) == 7]
    assert named == [[row.what, row.sources] for row in published_rows.ROWS]
    numbers = {number for _, sources in named for number in sources.split(", ") if number.isdigit()}
    assert [number for number in sorted(numbers) if f"\n{number}. " not in PAGE] == []


def test_every_scene_loads_and_has_a_row() -> None:
    scenes = {path.stem for path in laws.SCENES.glob("*.yaml")}
    assert scenes == {row.scene for row in published_rows.ROWS}
    for scene in scenes:
        lidar_emu.load(laws.SCENES / f"{scene}.yaml")


@pytest.mark.parametrize(
    ("published", "ours", "allowed", "is_bound", "verdict"),
    [
        (Figure(2.0, 0.0), Figure(2.29, 0.1), 0.0, False, "agrees"),
        (Figure(2.0, 0.0), Figure(2.4, 0.1), 0.0, False, "**differs: 1.2 times**"),
        (Figure(2.0, 0.1), Figure(2.4, 0.1), 0.0, False, "agrees"),
        (Figure(2.0, 0.0), Figure(2.4, 0.1), 0.06, False, "agrees"),
        (Figure(2.0, 0.0), Figure(-1.9, 0.1), 0.0, True, "within"),
        (Figure(2.0, 0.0), Figure(-2.2, 0.1), 0.0, True, "**differs: 1.1 times**"),
    ],
)
def test_verdicts(published: Figure, ours: Figure, allowed: float, is_bound: bool, verdict: str) -> None:
    assert laws.Line("", published, ours, allowed, is_bound).verdict == verdict


def test_figures_of_known_values() -> None:
    """A normal deviation is known to 1/√(2n), a mean to 1/√n."""
    values = np.random.default_rng(2).standard_normal(20_000)
    assert laws.deviation(values) == pytest.approx((1.0, 0.005), rel=0.03)
    assert laws.mean(values).error == pytest.approx(1.0 / np.sqrt(20_000), rel=0.03)
    assert laws.ratio(Figure(3.0, 0.03), Figure(1.5, 0.0)) == pytest.approx((2.0, 0.02))


def differing(lines: list[laws.Line]) -> list[str]:
    return [line.quantity for line in lines if not line.agrees]


@pytest.mark.slow
def test_static_speckle() -> None:
    """At 60 degrees and 2 km the errors saturate at the bin."""
    lines = list(laws.static_speckle(12))
    saturated = [line.quantity for line in lines[-2:]]
    assert {saturated[1]} <= set(differing(lines)) <= set(saturated)
    assert all(line.ours.value < line.published.value for line in lines[-2:])


@pytest.mark.slow
def test_detection() -> None:
    assert differing(list(laws.detection(8))) == []


@pytest.mark.slow
def test_line_of_a_moving_field() -> None:
    assert differing(list(laws.moving_speckle(4))) == []


def test_the_flight_is_read_where_it_is(public_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise of the flight, or of its twin, is above that of normal errors: 95 % over the median is 2.9."""
    monkeypatch.setenv("LIDAR_EMU_REAL_DATA", str(public_data))
    tails, size = published_rows.real_flight(1)
    assert 2.9 < tails.published.value < 9.0
    assert size.published.value > 0.1 > 1e3 * size.ours.value
    monkeypatch.setenv("LIDAR_EMU_REAL_DATA", "nowhere")
    with pytest.raises(SystemExit, match=r"LIDAR_EMU_REAL_DATA: no file nowhere"):
        list(published_rows.real_flight(1))
    monkeypatch.delenv("LIDAR_EMU_REAL_DATA")
    assert list(published_rows.real_flight(1)) == []
