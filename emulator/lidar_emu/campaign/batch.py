"""Batches: consecutive runs that one process flies one after another and stores in a file of each table.

Which runs make a batch follows from the campaign alone, and a batch's files from the batch alone: the bytes are
the same whichever process flies it, and however often.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from lidar_emu.campaign.kept_flight import KeptFlight
from lidar_emu.campaign.read import Base
from lidar_emu.campaign.tables import FlownRun, beams_table, runs_table, write_table
from lidar_emu.errors import InputError, RunError, one_line
from lidar_emu.measurement import Measurement
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import measure_whole


class Batch(NamedTuple):
    """Runs in a row."""

    number: int
    first_run: int
    values: list[dict[str, Any]]
    """What each of them sets."""
    deadly: frozenset[int] = frozenset()
    """Runs that crash their process."""

    @property
    def runs(self) -> range:
        """Their numbers."""
        return range(self.first_run, self.first_run + len(self.values))


class BatchSettings(NamedTuple):
    """Settings that all batches share."""

    base: Base
    folder: Path
    """Where the tables are kept: `runs` and `beams`."""
    kinds: dict[str, str]
    """Of the columns that hold what was drawn."""
    beams_every: int


def fly_batch(settings: BatchSettings, batch: Batch) -> int:
    """Fly the runs, store them, and return how many failed.

    Raises:
        InputError: the folder is not there.
        RunError: a file could not be written.
    """
    flown = [_fly(settings.base, run, batch) for run in batch.runs]
    kept = [one for one in flown if one.measurement is not None and one.run % settings.beams_every == 0]
    if kept:
        write_table(beams_table(kept), part_path(settings.folder, "beams", batch.number))
    # Last, because by this file a batch is known to be done.
    write_table(runs_table(flown, settings.kinds), part_path(settings.folder, "runs", batch.number))
    return sum(one.reason is not None for one in flown)


def probe(base: Base, values: dict[str, Any]) -> int:
    """Fly a run without storing it, to see whether the process survives it; return 0."""
    with suppress(Exception):
        measured(base, values)
    return 0


def part_path(folder: Path, table: str, number: int) -> Path:
    """The file of a batch."""
    return folder / table / f"part-{number:05d}.parquet"


def _fly(base: Base, run: int, batch: Batch) -> FlownRun:
    values = batch.values[run - batch.first_run]
    if run in batch.deadly:
        return FlownRun(run, values, None, "its process died, with other runs beside it and alone")
    try:
        return FlownRun(run, values, measured(base, values), None)
    except (InputError, RunError) as error:
        reason = str(error)
    except Exception as error:  # a run that cannot be flown is one of the results, whatever the reason
        reason = f"{type(error).__name__}: {error}"
    return FlownRun(run, values, None, one_line(reason))


def measured(base: Base, values: dict[str, Any]) -> Measurement:
    """One run; ground and trajectory are those of a run before where they are the same.

    Raises:
        InputError: the values are not allowed, or the flight is not possible.
    """
    scenario = base.scenario_of(values)
    return measure_whole(FlightModel(scenario, KeptFlight(scenario)))
