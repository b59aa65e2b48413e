"""Batches: consecutive runs that one process simulates in order and stores in one file per table.

The campaign alone determines the batches, and a batch alone determines the bytes of its files: neither the process nor
the number of attempts matters. A few runs forecast the computing time, memory and disk space of all.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from filelock import FileLock, Timeout

from lidar_emu._version import __version__
from lidar_emu.beams.flight import Flight, build_trajectory
from lidar_emu.campaign.description import Base, PreparedCampaign
from lidar_emu.campaign.statistics import TALLIED, Tally, tally_beams
from lidar_emu.campaign.tables import RunResult, column_kinds, read_columns, write_beams, write_runs
from lidar_emu.errors import Finding, InputError, RunError, one_line, reason_of
from lidar_emu.files import read_bytes, whole_file
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.compilation import compilation_reported_to
from lidar_emu.runtime.clock import Clock
from lidar_emu.scenario.load import hashed_files
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scenario.trajectory import Trajectory as TrajectoryPart
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.ray_hits import Scene
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import build_model, initial_state, measure, measure_whole
from lidar_emu.trajectory.profile import Trajectory

_KEPT = 4
_NOT_OF_THE_GRID = {"name", "surface", "atmosphere", "sunlight_w_per_m2_um", "objects"}


class CachedFlight(Flight):
    """A flight with cached trajectory and whole grids; other ground is quick to build or cropped to the flight."""

    @cached_property
    def trajectory(self) -> Trajectory:
        part = self.scenario.trajectory
        return _trajectory(type(part), part.model_dump_json(), self.scenario.site.body.radius_m)

    @cached_property
    def ground(self) -> Scene:
        site = self.scenario.site
        kept = _grids(site.model_dump_json(exclude=_NOT_OF_THE_GRID))
        if not kept:
            made = super().ground
            if isinstance(made, GridGround):
                kept.append(made)
            return made
        return kept[0].with_reflectance(site.surface.reflectance)


@lru_cache(_KEPT)
def _grids(_site: str) -> list[GridGround]:
    """Cache entry for the grid of a site."""
    return []


@lru_cache(_KEPT)
def _trajectory(kind: type[TrajectoryPart], part: str, body_radius_m: float) -> Trajectory:
    return build_trajectory(kind.model_validate_json(part), body_radius_m)


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


BatchOutcome = tuple[list[str], Tally]
"""Reasons of the failed runs of a batch, and the counts of its beams."""


def fly_batch(settings: BatchSettings, batch: Batch) -> BatchOutcome:
    """Fly the runs of a batch and store them.

    Raises:
        InputError: the folder is missing.
        RunError: a file could not be written.
    """
    flown = [_fly(settings.base, run, batch) for run in batch.runs]
    kept = [one for one in flown if one.measurement is not None and one.run % settings.beams_every == 0]
    tally: Tally = {}
    if kept:
        beams = write_beams(kept, part_path(settings.folder, "beams", batch.number))
        tally = tally_beams(beams, settings.beams_every)
    # Last, because this file marks the batch as done.
    write_runs(flown, settings.kinds, part_path(settings.folder, "runs", batch.number))
    return [one.reason for one in flown if one.reason is not None], tally


def stored_batch(folder: Path, number: int, beams_every: int) -> BatchOutcome:
    """Outcome of a batch that was stored earlier, from its files.

    Raises:
        InputError: a file is damaged.
    """
    failed = read_columns(part_path(folder, "runs", number), ["failed"])["failed"]
    path = part_path(folder, "beams", number)
    tally = tally_beams(read_columns(path, TALLIED), beams_every) if path.exists() else {}
    return [reason for reason in failed if reason is not None], tally


def warm_up(scenario: FlightScenario) -> int | None:
    """As `measure_one_shot`, or None if kernels must be compiled first."""

    def refuse(kernel: str) -> None:
        raise RunError(kernel)

    try:
        with compilation_reported_to(refuse):
            return measure_one_shot(scenario)
    except RunError:
        return None


def measure_one_shot(scenario: FlightScenario) -> int:
    """Measure the first shot of a run, which loads or compiles all kernels; return the beams in all of its shots.

    Raises:
        InputError: the flight is impossible.
    """
    model = build_model(scenario)
    measure(model, 0, 1, initial_state(model))
    return model.shot_count * model.beam_count


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
        InputError: a value cannot be used, or the flight is impossible.
    """
    scenario = base.scenario_of(values)
    return measure_whole(FlightModel(scenario, CachedFlight(scenario)))


_TABLES = ("runs", "beams")
_STATED = "campaign.json"
_MOST_BYTES = 10_000_000


@contextmanager
def campaign_folder(folder: Path, prepared: PreparedCampaign, batch_runs: int) -> Iterator[None]:
    """Create the folder, or continue one that holds part of the same campaign, and lock it meanwhile.

    Raises:
        InputError: the folder holds something else, cannot be created, or is in use by another process.
    """
    stated = _statement(prepared, batch_runs)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / _STATED).exists() and any(entry.name != ".lock" for entry in folder.iterdir()):
            raise InputError("--out", None, Finding(f"{folder} holds other files"), _REMEDY)
        lock = FileLock(folder / ".lock").acquire(blocking=False)
    except Timeout:
        raise InputError(
            "--out", None, Finding(f"{folder} is in use"), "run one campaign command at a time"
        ) from None
    except (OSError, ValueError) as error:
        reason = Finding(f"{folder}: {reason_of(error)}")
        raise InputError("--out", None, reason, "name a writable folder") from None
    with lock:
        _claim(folder, stated)
        _sweep(folder)
        try:
            yield
        finally:
            _sweep(folder)


_REMEDY = "name a new or empty folder, or the folder of the same campaign, which is then continued"


def _claim(folder: Path, stated: dict[str, Any]) -> None:
    path = folder / _STATED
    if path.exists():
        try:
            before = json.loads(read_bytes(path, _MOST_BYTES, _REMEDY))
        except (ValueError, RecursionError):
            before = None
        if before != stated:
            raise InputError("--out", None, Finding(f"{folder} {_difference(before, stated)}"), _REMEDY)
    for table in _TABLES:
        (folder / table).mkdir(exist_ok=True)
    if not path.exists():
        with whole_file(path) as file:
            file.write(json.dumps(stated, indent=2).encode() + b"\n")


def _sweep(folder: Path) -> None:
    """Delete partial files left by processes that died."""
    for table in _TABLES:
        for left_over in (folder / table).glob(".part-*"):
            left_over.unlink(missing_ok=True)


def _difference(before: Any, stated: dict[str, Any]) -> str:
    if not isinstance(before, dict):
        return f"has a {_STATED} that cannot be read"
    return f"holds another campaign (different: {', '.join(_differing(before, stated))})"


def _differing(before: Any, stated: Any) -> Iterator[str]:
    """Yield the dotted keys of values that differ, descending where both are mappings."""
    for key in dict.fromkeys((*stated, *before)):
        then, now = before.get(key), stated.get(key)
        if isinstance(then, dict) and isinstance(now, dict):
            yield from (f"{key}.{below}" for below in _differing(then, now))
        elif then != now:
            yield key


def _statement(prepared: PreparedCampaign, batch_runs: int) -> dict[str, Any]:
    """Describe everything that determines the contents of the folder's files."""
    campaign = json.loads(prepared.campaign.model_dump_json())
    return {
        "lidar_emu": __version__,
        "name": campaign["name"],
        "campaign": campaign,
        "runs_per_file": batch_runs,
        "first_run": json.loads(prepared.first.model_dump_json()),
        "files_sha256": dict(hashed_files(prepared.first)),
    }


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
        write_beams([flown], beams)
        write_runs([flown], column_kinds(prepared.campaign), runs)
        return beams.stat().st_size / prepared.campaign.beams_every + runs.stat().st_size
