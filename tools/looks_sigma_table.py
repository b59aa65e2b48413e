"""Update the table of docs/evidence/accuracy.md on the sigma that an instrument of several looks states.

python tools/looks_sigma_table.py                rewrites the table between the two markers; two minutes
python tools/looks_sigma_table.py --print        prints it
python tools/looks_sigma_table.py --shots 300    with fewer measurements than 2000 a row

Scenes and scores as in tools/sigma_table.py. The reference has no looks.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

from page_table import update
from sigma_table import Cell

HEADINGS = (
    "altitude; sideways, down; beam", "looks", "level",
    "range error / sigma", "beyond 2, 3 %", "speed error / sigma", "beyond 2, 3 %",
)  # fmt: skip


class Place(NamedTuple):
    """Motion and beam over level ground, and the instrument where it has other peaks or light."""

    altitude_m: float
    sideways_mps: float
    sink_mps: float
    off_nadir_deg: float = 7.5
    peak: str = "hann"
    speckle: bool = True


PLACES = (
    Place(300.0, 20.0, 0.2, 0.0),
    Place(300.0, 20.0, 2.0),
    Place(50.0, 10.0, 0.2),
    Place(2000.0, 30.0, 2.0),
    Place(100.0, 1.0, 0.2),
    Place(300.0, 100.0, 2.0, 0.0),
    Place(300.0, 20.0, 2.0, speckle=False),
    Place(300.0, 20.0, 2.0, peak="bin"),
)


def rows(shots: int) -> Iterator[tuple[str, ...]]:
    """Rows of the table."""
    for place, looks, level in product(PLACES, (4, 16), ("spectral", "statistical")):
        cell = Cell(place.peak, 0.0, place.speckle, *place[:4], looks)
        _, *both = cell.scores({"level": level}, shots)
        scene = f"{place.altitude_m:g} m; {place.sideways_mps:g}, {place.sink_mps:g} m/s; {place.off_nadir_deg:g}°"
        scene += "" if place.speckle else ", no speckle"
        scene += ", quantised" if place.peak == "bin" else ""
        yield scene, str(looks), level, *(score.cells() for score in both)


if __name__ == "__main__":
    update("looks", HEADINGS, rows, 2000, None)
