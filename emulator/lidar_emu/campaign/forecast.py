"""What a campaign will take, from a few of its runs flown here."""

from __future__ import annotations

import resource
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lidar_emu.campaign.batch import measured
from lidar_emu.campaign.read import PreparedCampaign
from lidar_emu.campaign.tables import FlownRun, beams_table, column_kinds, runs_table, write_table
from lidar_emu.errors import InputError, RunError
from lidar_emu.runtime.clock import Clock

_SLICE = 8
_BYTES_PER_KIB = 1024


class Forecast(NamedTuple):
    """Of a campaign that is yet to be flown."""

    runs: int
    flown: int
    """Runs that the figures come from; those that cannot be flown are left out."""
    run_s: float
    """Of one core, for a run with all that is kept of it: median."""
    flight_s: float
    """Length of the flights: median."""
    process_bytes: int
    """Memory of a worker: what this process has needed for the same."""
    run_bytes: int
    """On disk, of a run: mean."""

    def hours(self, workers: int) -> float:
        """Of all runs."""
        return self.runs * self.run_s / workers / 3600

    @property
    def disk_bytes(self) -> int:
        """Of all runs."""
        return self.runs * self.run_bytes


def forecast(prepared: PreparedCampaign) -> Forecast:
    """Fly a few runs, spread over the campaign, and keep them for as long as it takes to see how large they are.

    Raises:
        RunError: none of them can be flown.
    """
    clock, runs = Clock(), prepared.campaign.runs
    times_s: list[float] = []
    flights_s, sizes, reason = [], [], ""
    for run in np.unique(np.linspace(0, runs - 1, min(runs, _SLICE)).astype(int)).tolist():
        values = prepared.drawn.values(run)
        try:
            if not times_s:
                measured(prepared.base, values)  # compiles, and reads the ground
            begun_ns = clock.now_ns()
            measurement = measured(prepared.base, values)
            sizes.append(_kept_bytes(prepared, FlownRun(run, values, measurement, None)))
        except (InputError, RunError) as error:
            reason = str(error)
            continue
        times_s.append((clock.now_ns() - begun_ns) * 1e-9)
        period_ns = prepared.base.scenario_of(values).timing.period_ns
        flights_s.append(len(measurement) * period_ns * 1e-9)
    if not times_s:
        raise RunError(f"none of {min(runs, _SLICE)} runs can be flown: {reason}")
    return Forecast(
        runs=runs,
        flown=len(times_s),
        run_s=float(np.median(times_s)),
        flight_s=float(np.median(flights_s)),
        process_bytes=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _BYTES_PER_KIB,
        run_bytes=round(float(np.mean(sizes))),
    )


def _kept_bytes(prepared: PreparedCampaign, flown: FlownRun) -> float:
    """What a run takes on disk, with its share of the files' own size if every file holds one."""
    with tempfile.TemporaryDirectory() as folder:
        beams, runs = Path(folder) / "beams", Path(folder) / "runs"
        write_table(beams_table([flown]), beams)
        write_table(runs_table([flown], column_kinds(prepared.campaign)), runs)
        return beams.stat().st_size / prepared.campaign.beams_every + runs.stat().st_size
