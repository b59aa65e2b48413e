"""Update the table of docs/evidence/accuracy.md on dust of a plume: the reference beside the fast levels.

python tools/plume_table.py              rewrites the table between the two markers; a quarter of an hour
python tools/plume_table.py --print      prints it
python tools/plume_table.py --shots 100  with fewer measurements of the reference than 400

A single beam 8 m over level ground, sinking at 1 m/s, with the dust of `dusty_landing.yaml` except for the keys of the
scene. The figures are as in `haze_table`.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

from haze_table import FAST_TIMES, LEVELS, RATE_HZ, SHOTS_PER_RUN, rows
from page_table import update

HEIGHT_M, DOWN_MPS = 8.0, 1.0


class Scene(NamedTuple):
    """A beam onto dust."""

    tilt_deg: float
    optical_depth: float
    streak_optical_depth: float = 0.0
    """Of a streak that each beam meets; 0: none."""

    def __str__(self) -> str:
        streak = f", streaks of {self.streak_optical_depth:g}" if self.streak_optical_depth else ""
        return f"{self.tilt_deg:g}\N{DEGREE SIGN}, depth {self.optical_depth:g}{streak}"

    def settings(self) -> dict[str, str]:
        """Keys of a scenario that flies the scene."""
        half_m = 0.51 * DOWN_MPS * SHOTS_PER_RUN / RATE_HZ
        waypoints = ", ".join(
            f"{{altitude_m: {HEIGHT_M + side * half_m}, speed_mps: {DOWN_MPS}}}" for side in (1, -1)
        )
        streaks = (
            f"streak_share: {float(self.streak_optical_depth > 0.0)}, "
            f"streak_optical_depth: {self.streak_optical_depth}"
        )
        return {
            "timing.rate_hz": str(RATE_HZ),
            "duration_s": str(SHOTS_PER_RUN / RATE_HZ),
            "site": "flat",
            "scanner": f"{{pattern: {{kind: directions, beams: [[{self.tilt_deg}, 0]]}}}}",
            "trajectory": f"{{kind: profile, waypoints: [{waypoints}]}}",
            "plume": f"{{optical_depth: {self.optical_depth}, {streaks}}}",
        }


SCENES = (Scene(22.5, 1.5), Scene(22.5, 0.5, 2.0), Scene(0.2, 1.0))


if __name__ == "__main__":
    headings = "beam off nadir, dust", *LEVELS, "spectral, statistical: errors apart"
    update("plume", headings, partial(rows, SCENES), 400, FAST_TIMES)
