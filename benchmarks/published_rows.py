"""Rows of docs/evidence/published.md: figures of others beside the emulator's, from scenes in benchmarks/published.

New Shepard's record is not in the repository: LIDAR_EMU_REAL_DATA names the folder that has it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from math import sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.published_laws import (
    Line,
    bad_estimates,
    detection,
    deviation,
    exact,
    fly,
    mean,
    moving_speckle,
    outliers,
    phase_noise,
    ratio,
    scenario_of,
    static_speckle,
)
from benchmarks.scenes import REFERENCE
from benchmarks.speckle_table import Figure
from benchmarks.tables import Part
from lidar_emu.numerics.arrays import FloatArray

HEADINGS = "figure", "source", "scene", "quantity", "published", "emulator", "verdict"

_TOUCHDOWN_NS = 1_602_596_210_210_000_000 + 447_830_000_000
"""Time of New Shepard's touchdown in its record."""


class Row(NamedTuple):
    """A figure, law or table by others."""

    what: str
    sources: str
    """Their numbers on the page."""
    scene: str
    measure: Callable[[int], Iterator[Line]]
    """Yields lines from a number of runs, or of seconds at level reference."""
    runs: int


def hard_target(runs: int) -> Iterator[Line]:
    """Bias of the speed of a hard target, and its scatter beside ideal light."""
    scenario = scenario_of("hard_target")
    found = []
    for keys, count in (({}, runs), (REFERENCE | {"duration_s": 2}, 2)):
        errors = [
            run.closing_speed_mps - run.true_closing_speed_mps for run in fly(scenario.with_(keys), count)
        ]
        found.append(np.concatenate(errors).ravel())
    ours, ideal = (errors[np.isfinite(errors)] for errors in found)
    yield Line("systematic error of the speed, m/s", exact(0.036), mean(ours), is_bound=True)
    yield Line("scatter over that of ideal light", exact(1.0), ratio(deviation(ours), deviation(ideal)), 0.3)


def published_quantisation(runs: int) -> Iterator[Line]:
    """Scatter by rounding to bins, at one closing speed and while it changes."""
    steady = {
        "trajectory.waypoints": [{"altitude_m": height_m, "speed_mps": 66.0} for height_m in (2000, 500)]
    }
    for keys, name in ((steady, "at one closing speed"), ({}, "braking")):
        found = fly(scenario_of("budge_descent", keys), runs)
        errors_m = np.concatenate([run.range_m - run.true_range_m for run in found]).ravel()
        yield Line(f"scatter of the range {name}, m", exact(0.099), deviation(errors_m), allowed=0.005)
    # All beams have one speed.
    errors_mps = np.concatenate([run.closing_speed_mps - run.true_closing_speed_mps for run in found])[:, 0]
    yield Line("scatter of the speed braking, mm/s", exact(1.024), deviation(1e3 * errors_mps), allowed=5e-4)


def _within(scene: str, runs: int, most_m: float, most_mps: float) -> Iterator[Line]:
    """Errors that 99.7 % of the valid measurements are within; their own errors are by the scatter between runs."""
    found = []
    for run in fly(scenario_of(scene), runs):
        pairs = (run.range_m, run.true_range_m), (run.closing_speed_mps, run.true_closing_speed_mps)
        found.append([np.quantile(np.abs(one - other)[run.range_valid], 0.997) for one, other in pairs])
    ranges_m, speeds_mps = np.array(found).T
    yield Line("99.7 % of range errors within, m", exact(most_m), mean(ranges_m), is_bound=True)
    yield Line("99.7 % of speed errors within, m/s", exact(most_mps), mean(speeds_mps), is_bound=True)


def stated_performance(runs: int) -> Iterator[Line]:
    """NASA's figures for the flown unit."""
    yield from _within("ndl_descent", runs, 2.0, 0.02)


def reconstruction(runs: int) -> Iterator[Line]:
    """Residuals of the reconstructed IM-1 landing, which contain those of the trajectory and the map."""
    yield from _within("lunar_landing", runs, 5.0, 0.5)


def _second_differences(speeds_mps: FloatArray) -> tuple[float, float]:
    """Median of their size, and 95 % over it, means over the beams."""
    sizes = np.abs(np.diff(speeds_mps, 2, axis=0))
    median, high = np.nanquantile(sizes, (0.5, 0.95), axis=0)
    return float(median.mean()), float((high / median).mean())


def real_flight(runs: int) -> Iterator[Line]:
    """Scatter of four beams' speeds in the ten seconds before touchdown, by second differences in time."""
    folder = os.environ.get("LIDAR_EMU_REAL_DATA")
    if folder is None:
        return
    path = Path(folder) / "lidar" / "ns13_boddl_commercial_lidar.csv"
    if not path.exists():
        raise SystemExit(f"LIDAR_EMU_REAL_DATA: no file {path}")
    rows = np.genfromtxt(path, delimiter=",", skip_header=1)
    before_s = (_TOUCHDOWN_NS - rows[:, 0]) * 1e-9
    beams = rows[(before_s > 0.0) & (before_s <= 10.0), 5:9]
    flown = np.array([_second_differences(beams[:, k : k + 1]) for k in range(4)])
    ours = np.array(
        [_second_differences(run.closing_speed_mps) for run in fly(scenario_of("new_shepard_landing"), runs)]
    )
    names = "median second difference of the speed, m/s", "95 % of second differences over their median"
    for k in (1, 0):
        measured = Figure(float(flown[:, k].mean()), float(flown[:, k].std(ddof=1) / sqrt(4.0)))
        yield Line(names[k], measured, mean(ours[:, k]))


ROWS = (
    Row("static speckle on a slope", "law", "static_speckle", static_speckle, 120),
    Row("outliers by speckle", "1", "static_speckle", outliers, 30),
    Row("line of a moving speckle field", "law", "moving_speckle", moving_speckle, 10),
    Row("detection of steady and fading targets", "2, 3", "detection", detection, 40),
    Row("share of bad frequency estimates", "4", "bad_estimates", bad_estimates, 2),
    Row("hard target of a 2 µm lidar", "5", "hard_target", hard_target, 10),
    Row("phase noise beyond the coherence length", "6", "phase_noise", phase_noise, 1),
    Row("quantisation of the published instrument", "7", "budge_descent", published_quantisation, 1),
    Row("the flown NDL, as stated", "8, 9", "ndl_descent", stated_performance, 10),
    Row("IM-1, reconstructed", "10", "lunar_landing", reconstruction, 10),
    Row("New Shepard NS-13", "11", "new_shepard_landing", real_flight, 40),
)


def parts() -> Iterator[Part]:
    """All rows; one whose data are not here says so."""
    yield HEADINGS
    for row in ROWS:
        first = row.what, row.sources, f"`{row.scene}.yaml`"
        for line in row.measure(row.runs):
            published, ours = (_text(figure) for figure in (line.published, line.ours))
            published = f"at most {published}" if line.is_bound else published
            yield *first, line.quantity, published, ours, line.verdict
            first = "", "", ""
        if first[0]:
            yield *first, "", "the data are not here", "", "not measured"
    yield f"Measured on {datetime.now(UTC).date()}."


def _text(figure: Figure) -> str:
    return f"{figure.value:.4g}" + (f" ± {figure.error:.1g}" if figure.error else "")
