"""Batches: consecutive runs that one process simulates in order and stores in one file per table.

The campaign alone determines the batches, and a batch alone determines the bytes of its files: neither the process nor
the number of attempts matters.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from lidar_emu.campaign.cached_flight import CachedFlight
from lidar_emu.campaign.read import Base
from lidar_emu.campaign.tables import RunResult, beams_table, runs_table, write_table
from lidar_emu.errors import InputError, RunError, one_line
from lidar_emu.measurement import Measurement
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import measure_whole


class Batch(NamedTuple):
    """Consecutive runs."""

    number: int
    first_run: int
    values: list[dict[str, Any]]
    """Values of each run by dotted key."""
    crashing: frozenset[int] = frozenset()
    """Runs that crash their process."""

    @property
    def runs(self) -> range:
        """Numbers of the runs."""
        return range(self.first_run, self.first_run + len(self.values))


class BatchSettings(NamedTuple):
    """Settings that all batches share."""

    base: Base
    folder: Path
    """Folder of the tables `runs` and `beams`."""
    kinds: dict[str, str]
    """Kind of each column of drawn values, see `column_kinds`."""
    beams_every: int
    """Beams are stored for every nth run."""


def fly_batch(settings: BatchSettings, batch: Batch) -> int:
    """Fly the runs of a batch, store them, and return the number of failed runs.

    Raises:
        InputError: the folder is missing.
        RunError: a file could not be written.
    """
    flown = [_fly(settings.base, run, batch) for run in batch.runs]
    kept = [one for one in flown if one.measurement is not None and one.run % settings.beams_every == 0]
    if kept:
        write_table(beams_table(kept), part_path(settings.folder, "beams", batch.number))
    # Last, because this file marks the batch as done.
    write_table(runs_table(flown, settings.kinds), part_path(settings.folder, "runs", batch.number))
    return sum(one.reason is not None for one in flown)


def probe(base: Base, values: dict[str, Any]) -> int:
    """Fly a run without storing it, to test whether it crashes the process; return 0."""
    with suppress(Exception):
        measure_run(base, values)
    return 0


def part_path(folder: Path, table: str, number: int) -> Path:
    """Path of a batch's file."""
    return folder / table / f"part-{number:05d}.parquet"


def _fly(base: Base, run: int, batch: Batch) -> RunResult:
    values = batch.values[run - batch.first_run]
    if run in batch.crashing:
        return RunResult(run, values, None, "its process died, with other runs in progress and alone")
    try:
        return RunResult(run, values, measure_run(base, values), None)
    except (InputError, RunError) as error:
        reason = str(error)
    except Exception as error:  # a failed run is a result, whatever the reason
        reason = f"{type(error).__name__}: {error}"
    return RunResult(run, values, None, one_line(reason))


def measure_run(base: Base, values: dict[str, Any]) -> Measurement:
    """Measure one run, with ground and trajectory cached from earlier runs where they are the same.

    Raises:
        InputError: a value is not allowed, or the flight is impossible.
    """
    scenario = base.scenario_of(values)
    return measure_whole(FlightModel(scenario, CachedFlight(scenario)))
