"""Measure every extreme and write docs/stability.md: python tests/stability/make_table.py"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "support")]

from extremes import EXTREMES  # noqa: E402
from flights import FLIGHTS  # noqa: E402
from outcomes import Extreme, Outcome  # noqa: E402
from slow_truth import SLOW_TRUTH  # noqa: E402

PAGE = HERE.parents[1] / "docs" / "stability.md"
ALL = [*EXTREMES, *SLOW_TRUTH, *FLIGHTS]

_HEADING = """# Extremes

What the receiver reports at the ends of what it can be given. Nowhere does a NaN, an infinity, a negative range or a
negative variance leave as valid, and what is not valid says why.

Unless a row says otherwise: one scatterer at 60 dB, no speckle, no linewidth, a flat receiver, the three-bin peak and
least squares over three segments. Errors are the largest of all beams that are valid with their sign resolved, of
closing speed modulo λ fs/2, beyond what any two of the segments truly say: range and speed of each record's own time,
so that what three segments one after another read wrongly does not count. "Allowed" stands beside six of the beam's
own standard deviations. Bins are of the tones of single
segments.

Written by `tests/stability/make_table.py`; the tests hold every column but the errors to it, and the errors to what is
allowed.

| extreme | must it be valid? | what is reported | largest error: m; mm/s; bins | allowed: m; mm/s | against what |
|---|---|---|---|---|---|
"""


def row(extreme: Extreme, outcome: Outcome) -> list[str]:
    """Cells of one row."""
    names = sorted(reason.name.lower().replace("_", " ") for reason in outcome.reasons)
    reported = ", ".join(names)
    if "valid" in names:
        reported += "; sign resolved" if outcome.resolved else "; sign not always resolved"
    errors = f"{outcome.range_m:.1g}; {1e3 * outcome.speed_mps:.1g}; {outcome.tone_bin:.1g}"
    if outcome.excess_m == float("-inf"):
        errors = "none compared"
    allowed = f"{extreme.beside_m:g}; {1e3 * extreme.beside_mps:g}".replace("inf; inf", "not bounded")
    return [extreme.name, extreme.must_be_valid, reported, errors, allowed, extreme.against]


def page(rows: list[list[str]]) -> str:
    """The whole text."""
    return _HEADING + "".join(f"| {' | '.join(cells)} |\n" for cells in rows)


if __name__ == "__main__":
    PAGE.write_text(page([row(extreme, extreme.measure()) for extreme in ALL]), encoding="utf-8")
