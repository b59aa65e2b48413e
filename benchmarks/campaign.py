"""Speed of campaigns: one core relative to real time, a pool relative to as many independent processes.

python -m benchmarks.campaign [--workers N] [--runs N]    flies dispersed_descent.yaml; docs/campaigns.md explains it
"""

from __future__ import annotations

import multiprocessing
import sys
import tempfile
from contextlib import closing
from dataclasses import dataclass
from multiprocessing.context import SpawnProcess
from pathlib import Path

import numpy as np

from benchmarks.tables import command_line
from lidar_emu.campaign.batch import Batch, BatchSettings, fly_batch, measure_one_shot
from lidar_emu.campaign.description import PreparedCampaign, prepare
from lidar_emu.campaign.run import LocalPool, fly_campaign, one_thread_each
from lidar_emu.campaign.tables import column_kinds
from lidar_emu.numerics.compilation import usable_cores
from lidar_emu.runtime.clock import Clock
from lidar_emu.scenario.parts import ChangedKey
from lidar_emu.shots.model import build_model

CAMPAIGN = "dispersed_descent.yaml"
LEVELS = ("geometric", "spectral")
_ROUNDS = 7
_RUNS_A_ROUND = 10
_COMPARISONS = 3


@dataclass(frozen=True)
class CoreSpeed:
    """Speed of one process that keeps everything of a run."""

    level: str
    flight_s: float
    """Length of the first flight."""
    run_s: float
    """Median of wall time for a run."""
    core_s: float
    """Median of processor time for a run."""


@dataclass(frozen=True)
class Scaling:
    """Times of the same runs in a pool and in as many independent processes, both including their start."""

    workers: int
    runs: int
    pool_s: float
    alone_s: float


def _at(level: str) -> list[ChangedKey]:
    return [ChangedKey("level", level, CAMPAIGN)]


def measure_cores() -> list[CoreSpeed]:
    """Measure the levels in turn, round by round, so that other load on the machine affects all alike."""
    prepared = {level: prepare(Path(CAMPAIGN), _at(level), _ROUNDS * _RUNS_A_ROUND) for level in LEVELS}
    clock, wall_s, core_s = Clock(), np.empty((len(LEVELS), _ROUNDS)), np.empty((len(LEVELS), _ROUNDS))
    with tempfile.TemporaryDirectory() as folder:
        for one in prepared.values():
            fly_batch(_settings(one, Path(folder)), _batch(one, 0, 1))
        for k in range(_ROUNDS):
            _show(f"one core: round {k + 1} of {_ROUNDS}")
            for i, one in enumerate(prepared.values()):
                begun_ns, processor_time_ns = clock.now_ns(), clock.processor_time_ns()
                fly_batch(_settings(one, Path(folder)), _batch(one, k * _RUNS_A_ROUND, _RUNS_A_ROUND))
                wall_s[i, k] = (clock.now_ns() - begun_ns) * 1e-9 / _RUNS_A_ROUND
                core_s[i, k] = (clock.processor_time_ns() - processor_time_ns) * 1e-9 / _RUNS_A_ROUND
    return [
        CoreSpeed(level, _flight_s(one), float(np.median(wall_s[i])), float(np.median(core_s[i])))
        for i, (level, one) in enumerate(prepared.items())
    ]


def measure_scaling(workers: int, runs: int) -> Scaling:
    """Fly `runs` at level geometric, where the overhead of a pool matters most; medians of several rounds."""
    prepared = prepare(Path(CAMPAIGN), _at(LEVELS[0]), runs)
    rows = measure_one_shot(prepared.first)
    clock, times_s = Clock(), np.empty((2, _COMPARISONS))
    for k in range(_COMPARISONS):
        _show(f"{workers} processes in a pool, and independent: round {k + 1} of {_COMPARISONS}")
        with tempfile.TemporaryDirectory() as folder:
            begun_ns = clock.now_ns()
            with closing(LocalPool(workers)) as pool:
                fly_campaign(prepared, rows, Path(folder) / "pool", pool, lambda _: None)
            between_ns = clock.now_ns()
            _fly_alone(prepared, workers, Path(folder) / "alone")
            times_s[:, k] = (between_ns - begun_ns) * 1e-9, (clock.now_ns() - between_ns) * 1e-9
    pool_s, alone_s = (float(time_s) for time_s in np.median(times_s, axis=1))
    return Scaling(workers, runs, pool_s, alone_s)


def _fly_alone(prepared: PreparedCampaign, workers: int, folder: Path) -> None:
    context = multiprocessing.get_context("spawn")
    processes: list[SpawnProcess] = []
    with one_thread_each():
        for shares in np.array_split(np.arange(prepared.campaign.runs), workers):
            settings = _settings(prepared, folder / str(len(processes)))
            batches = [_batch(prepared, int(run), 1) for run in shares]
            processes.append(context.Process(target=_fly_batches, args=(settings, batches)))
            processes[-1].start()
    for process in processes:
        process.join()


def _fly_batches(settings: BatchSettings, batches: list[Batch]) -> None:
    for batch in batches:
        fly_batch(settings, batch)


def _settings(prepared: PreparedCampaign, folder: Path) -> BatchSettings:
    for table in ("runs", "beams"):
        (folder / table).mkdir(parents=True, exist_ok=True)
    return BatchSettings(
        prepared.base, folder, column_kinds(prepared.campaign), prepared.campaign.beams_every
    )


def _batch(prepared: PreparedCampaign, first: int, count: int) -> Batch:
    return Batch(first, first, [prepared.drawn.values(run) for run in range(first, first + count)])


def _flight_s(prepared: PreparedCampaign) -> float:
    model = build_model(prepared.first)
    return model.shot_count * model.period_ns * 1e-9


def _show(what: str) -> None:
    print(what, file=sys.stderr, flush=True)


def main() -> None:
    """Print both comparisons."""
    parser = command_line(__doc__)
    parser.add_argument("--workers", type=int, default=usable_cores())
    parser.add_argument("--runs", type=int, default=400, help="runs of all workers together")
    options = parser.parse_args()
    cores, scaling = measure_cores(), measure_scaling(options.workers, options.runs)
    for core in cores:
        run = f"{core.run_s * 1e3:.1f} ms a run, {core.core_s * 1e3:.1f} ms of processor time"
        ratios = core.flight_s / core.run_s, core.flight_s / core.core_s
        print(f"{core.level}: {run}; {ratios[0]:.0f} and {ratios[1]:.0f} times faster than real time")
    share = scaling.alone_s / scaling.pool_s
    times = f"pool {scaling.pool_s:.2f} s, independent processes {scaling.alone_s:.2f} s"
    print(
        f"{scaling.runs} runs, {scaling.workers} processes: {times}; the pool reaches {100 * share:.0f} % of their rate"
    )
    print(f"ratio: {ratios[1]:.3g} (real time to processor time at level {LEVELS[-1]})")


if __name__ == "__main__":
    main()
