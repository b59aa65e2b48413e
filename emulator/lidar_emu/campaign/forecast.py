"""Forecast of a campaign's computing time, memory and disk space from a few of its runs."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lidar_emu.campaign.batch import measure_run
from lidar_emu.campaign.description import PreparedCampaign
from lidar_emu.campaign.tables import RunResult, beams_table, column_kinds, runs_table, write_table
from lidar_emu.errors import InputError, RunError
from lidar_emu.runtime.clock import Clock

_SLICE = 8
_BYTES_PER_KIB = 1024


class Forecast(NamedTuple):
    """Computing time, memory and disk space of a campaign."""

    runs: int
    flown: int
    """Number of runs behind the figures, without failed runs."""
    run_s: float
    """Median time of one core per run, including storing it."""
    flight_s: float
    """Median duration of the flights."""
    process_bytes: int | None
    """Memory of a worker: the peak of this process after the same runs; None where the system does not state it."""
    run_bytes: int
    """Mean disk space per run."""

    def hours(self, workers: int) -> float:
        """Time for all runs on a number of workers."""
        return self.runs * self.run_s / workers / 3600

    @property
    def disk_bytes(self) -> int:
        """Disk space of all runs."""
        return self.runs * self.run_bytes


def forecast(prepared: PreparedCampaign) -> Forecast:
    """Fly a few runs, spread over the campaign, and store them temporarily to measure their size.

    Raises:
        RunError: all of them failed.
    """
    clock, runs = Clock(), prepared.campaign.runs
    times_s: list[float] = []
    flights_s, sizes, reason = [], [], ""
    for run in np.unique(np.linspace(0, runs - 1, min(runs, _SLICE)).astype(int)).tolist():
        values = prepared.drawn.values(run)
        try:
            if not times_s:
                measure_run(prepared.base, values)  # compiles, and reads the ground
            begun_ns = clock.now_ns()
            measurement = measure_run(prepared.base, values)
            sizes.append(_kept_bytes(prepared, RunResult(run, values, measurement, None)))
        except (InputError, RunError) as error:
            reason = str(error)
            continue
        times_s.append((clock.now_ns() - begun_ns) * 1e-9)
        period_ns = prepared.base.scenario_of(values).timing.period_ns
        flights_s.append(len(measurement) * period_ns * 1e-9)
    if not times_s:
        raise RunError(f"all of {min(runs, _SLICE)} sample runs failed: {reason}")
    return Forecast(
        runs=runs,
        flown=len(times_s),
        run_s=float(np.median(times_s)),
        flight_s=float(np.median(flights_s)),
        process_bytes=_peak_bytes(),
        run_bytes=round(float(np.mean(sizes))),
    )


def _peak_bytes() -> int | None:
    try:
        import resource
    except ModuleNotFoundError:
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _BYTES_PER_KIB


def _kept_bytes(prepared: PreparedCampaign, flown: RunResult) -> float:
    """Disk space of a run, with the overhead of a file for each run."""
    with tempfile.TemporaryDirectory() as folder:
        beams, runs = Path(folder) / "beams", Path(folder) / "runs"
        write_table(beams_table([flown]), beams)
        write_table(runs_table([flown], column_kinds(prepared.campaign)), runs)
        return beams.stat().st_size / prepared.campaign.beams_every + runs.stat().st_size
