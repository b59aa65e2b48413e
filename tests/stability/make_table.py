"""Measure every extreme and write docs/evidence/stability.md: python tests/stability/make_table.py"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "support"), str(HERE.parents[1])]

from extremes import EXTREMES  # noqa: E402
from flights import FLIGHTS  # noqa: E402
from outcomes import Extreme, Outcome  # noqa: E402
from slow_truth import SLOW_TRUTH  # noqa: E402

PAGE = HERE.parents[1] / "docs" / "evidence" / "stability.md"
ALL = [*EXTREMES, *SLOW_TRUTH, *FLIGHTS]

_HEADING = """# Extremes

What the receiver reports at the extremes of its inputs. No NaN, infinity, negative range or negative
variance is ever reported as valid, and every invalid measurement states its reason.

Unless a row states otherwise: one scatterer at an SNR of 60 dB, no speckle, no linewidth, a flat receiver response, the
three-bin peak estimator and least squares over three segments. An error is the largest over all valid beams whose sign
is resolved, with the closing speed modulo λ fs/2. The reference is the range and speed at each record's own time: the
part of an error that follows from measuring three segments one after another does not count. The "allowed" error is
added to six of the beam's own standard deviations. Errors in bins are errors of the tones of single segments.

`lidar-emu bench stability my.yaml` flies your own instrument at extremes of its keys and of its flight, at each level.

`tests/stability/make_table.py` writes this page. The tests compare every column with it except the errors, which must
stay within the allowed ones.

| extreme | must it be valid? | what is reported | largest error: m; mm/s; bins | must be m; mm/s | reference |
|---|---|---|---|---|---|
"""


def row(extreme: Extreme, outcome: Outcome) -> list[str]:
    """Return the cells of one row."""
    names = sorted(reason.name.lower().replace("_", " ") for reason in outcome.reasons)
    reported = ", ".join(names)
    if "valid" in names:
        reported += "; sign resolved" if outcome.resolved else "; sign not always resolved"
    errors = f"{outcome.range_m:.1g}; {1e3 * outcome.speed_mps:.1g}; {outcome.tone_bin:.1g}"
    if outcome.excess_m == float("-inf"):
        errors = "none compared"
    beside_m, beside_mps = extreme.beside
    allowed = f"{beside_m:g}; {1e3 * beside_mps:g}".replace("inf; inf", "not bounded")
    return [extreme.name, extreme.must_be_valid, reported, errors, allowed, extreme.against]


def page(rows: list[list[str]]) -> str:
    """Return the whole page."""
    return _HEADING + "".join(f"| {' | '.join(cells)} |\n" for cells in rows)


if __name__ == "__main__":
    PAGE.write_text(page([row(extreme, extreme.measure()) for extreme in ALL]), encoding="utf-8")
