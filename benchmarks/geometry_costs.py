"""Table of docs/geometry.md: cost and saving of recorded geometry.

Direct runs and runs from the record take turns, each from the scenario to the measurement; the shortest of each counts.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from lidar_emu.report.geometry_export import record_geometry
from lidar_emu.scenario.load import load, require_flight
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.shots.model import build_model, measure_whole

TURNS = 15
FLIGHTS = {
    "`descent`, elevation grid": ("descent.yaml", {}),
    "`descent`, generated ground": ("descent.yaml", {"site": "cratered"}),
    "`powered_descent`, generated ground": ("powered_descent.yaml", {"site": "cratered"}),
}


LEVELS = "geometric", "spectral"


def parts() -> Iterator[tuple[str, ...]]:
    """Rows of the table."""
    yield (
        "flight", "shots", "beamlets", "a shot",
        *(cell for level in LEVELS for cell in (f"{level}, direct", "from the record", "ratio")),
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        for name, (scenario, settings) in FLIGHTS.items():
            for beamlets in (19, 61):
                changed = {**settings, "instrument.optics.beamlets": str(beamlets)}
                yield _row(name, scenario, changed, Path(folder) / "geometry.npz")


def _row(name: str, scenario: str, settings: dict[str, str], path: Path) -> tuple[str, ...]:
    cells: list[str] = []
    for level in LEVELS:
        flown = require_flight(load(scenario, {**settings, "level": level}))
        about = record_geometry(flown, path)
        direct_s, recorded_s = _shortest(flown, path)
        cells += [f"{direct_s * 1e3:.0f} ms", f"{recorded_s * 1e3:.0f} ms", f"{direct_s / recorded_s:.2f}"]
    size_kb = path.stat().st_size / about.shots / 1e3
    return name, str(about.shots), str(about.beamlets), f"{size_kb:.1f} kB", *cells


def _shortest(flown: FlightScenario, path: Path) -> tuple[float, float]:
    direct_s: list[float] = []
    recorded_s: list[float] = []
    for _ in range(1 + TURNS):
        for geometry, taken_s in ((None, direct_s), (path, recorded_s)):
            begun = time.perf_counter()
            measure_whole(build_model(flown, geometry))
            taken_s.append(time.perf_counter() - begun)
    return min(direct_s), min(recorded_s)
