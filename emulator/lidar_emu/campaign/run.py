"""Fly a campaign: submit batches to a pool, recover from worker crashes, store every run."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from lidar_emu.campaign.batch import (
    Batch,
    BatchOutcome,
    BatchSettings,
    campaign_folder,
    fly_batch,
    measure_one_shot,
    part_path,
    probe,
    stored_batch,
    warm_up,
)
from lidar_emu.campaign.description import PreparedCampaign
from lidar_emu.campaign.statistics import CampaignCounts
from lidar_emu.campaign.tables import column_kinds
from lidar_emu.errors import Finding, InputError, RunError
from lidar_emu.files import check_extra

_ONE_THREAD = dict.fromkeys(
    ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)
_CONNECT = "10s"


class Pool(Protocol):
    """An executor that may lose workers."""

    slots: int
    """Number of batches processed at once."""
    worker_errors: tuple[type[BaseException], ...]
    """Exceptions that a future raises when its worker died."""

    def submit(self, work: Callable[..., Any], *args: Any) -> Future[Any]:
        """As `concurrent.futures.Executor`."""

    def replace_workers(self) -> None:
        """Replace workers that died."""

    def check(self) -> None:
        """Check that results can still arrive.

        Raises:
            RunError: they cannot.
        """

    def close(self) -> None:
        """Release the workers, whatever they are doing."""


class LocalPool:
    """Processes on this machine, one thread each; they exit when this process ends, even if it is killed."""

    worker_errors: tuple[type[BaseException], ...] = (BrokenExecutor, CancelledError)

    def __init__(self, slots: int) -> None:
        self.slots = slots
        self._start()

    def submit(self, work: Callable[..., Any], *args: Any) -> Future[Any]:
        with one_thread_each(), _ctrl_c_blocked():
            return self._executor.submit(work, *args)

    def replace_workers(self) -> None:
        """Start a new executor, since an executor whose process died accepts no more work."""
        self.close()
        self._start()

    def check(self) -> None:
        """Nothing to do: futures of dead workers fail."""

    def close(self) -> None:
        """End the processes at once; unfinished files do not appear."""
        self._control_pipe.close()
        self._executor.shutdown(wait=True, cancel_futures=True)

    def _start(self) -> None:
        # Spawned, since a fork of a process with threads may hang.
        context = multiprocessing.get_context("spawn")
        theirs, self._control_pipe = context.Pipe(duplex=False)
        self._executor = ProcessPoolExecutor(
            self.slots, mp_context=context, initializer=_begin_worker, initargs=(theirs,)
        )


class ClusterPool:
    """The workers of a Dask scheduler, which reassigns the work of a dead worker.

    Raises:
        InputError: there is no scheduler, it has no workers, or Dask is not installed.
    """

    def __init__(self, address: str) -> None:
        check_extra("--scheduler", "a cluster", "distributed", "cluster")
        from distributed import Client, KilledWorker
        from distributed.comm import resolve_address

        try:
            # A client with an invalid address is left half built, and prints and waits when it is destroyed.
            resolve_address(address)
            self._client = Client(address, timeout=_CONNECT, set_as_default=False)
        except (OSError, ValueError) as error:
            found = Finding(f"{address}: no scheduler ({type(error).__name__})")
            raise InputError("--scheduler", None, found, "pass an address such as tcp://host:8786") from None
        self._address = address
        # `check` reports a lost connection.
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        self.slots = sum(self._client.nthreads().values())
        if self.slots == 0:
            raise InputError("--scheduler", None, Finding(f"{address} has no workers"), "start workers on it")
        self.worker_errors: tuple[type[BaseException], ...] = (KilledWorker, CancelledError)
        # Not pure: a batch writes files, so a repeated batch must run again.
        self._executor: Executor = self._client.get_executor(pure=False)

    def submit(self, work: Callable[..., Any], *args: Any) -> Future[Any]:
        self.check()
        return self._executor.submit(work, *args)

    def replace_workers(self) -> None:
        """Nothing to do: the scheduler replaces workers."""

    def check(self) -> None:
        """Check the connection: futures that are submitted while Dask reconnects never end if it fails.

        Raises:
            RunError: Dask has given up.
        """
        if self._client.status not in ("running", "connecting"):
            raise RunError(
                f"{self._address}: the scheduler is gone; repeat the command to fly the remaining runs"
            )

    def close(self) -> None:
        """Disconnect from the scheduler, which cancels unfinished batches."""
        self._client.close()


def _begin_worker(control_pipe: Connection) -> None:
    """Leave Ctrl-C to the parent, and exit once its end of the control pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def exit_with_parent() -> None:
        control_pipe.poll(None)
        os._exit(0)

    threading.Thread(target=exit_with_parent, daemon=True).start()


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Limit processes started meanwhile to one thread each, since there is a process per core."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


@contextmanager
def _ctrl_c_blocked() -> Iterator[None]:
    """Block SIGINT in processes started meanwhile, where a system can; this process receives it afterwards."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_ROWS_PER_FILE = 200_000
_LEAST_FILES = 256
_MOST_RUNS_PER_FILE = 256
_WAITING = 1
"""Batches queued per worker, so that none idles."""
_DEATHS_IN_A_ROW = 16
_CHECK_EVERY_S = 2.0


class CampaignProgress(NamedTuple):
    """Progress of a campaign."""

    runs: int
    done: int
    """Stored runs, including failed runs and runs of earlier invocations."""
    failed: int
    """Failed runs of this invocation."""


def runs_per_file(prepared: PreparedCampaign, rows_per_run: int) -> int:
    """Choose the number of runs per file from the campaign alone: enough files for all workers, of moderate size."""
    rows = max(1, rows_per_run // prepared.campaign.beams_every)
    return max(1, min(prepared.campaign.runs // _LEAST_FILES, _ROWS_PER_FILE // rows, _MOST_RUNS_PER_FILE))


def compile_kernels(prepared: PreparedCampaign, pool: Pool) -> int:
    """Start the workers; return the beams in all shots of a run.

    Kernels that are not in the cache are compiled by this process, once, so that all workers find them there.

    Raises:
        InputError: the flight is impossible.
    """
    started = [pool.submit(warm_up, prepared.first) for _ in range(pool.slots)]
    try:
        beams: int | None = wait(started, return_when=FIRST_COMPLETED).done.pop().result()
    except pool.worker_errors:
        pool.replace_workers()
        beams = None
    return measure_one_shot(prepared.first) if beams is None else beams


def fly_campaign(
    prepared: PreparedCampaign,
    rows_per_run: int,
    folder: Path,
    pool: Pool,
    on_progress: Callable[[CampaignProgress], None],
) -> tuple[CampaignProgress, CampaignCounts]:
    """Fly all runs that `folder` does not hold yet; return the final progress, and the counts of all runs.

    Args:
        prepared: the campaign.
        rows_per_run: approximate number of beams in all shots of a run.
        folder: folder of the results; a later call with the same folder continues the campaign.
        pool: the workers.
        on_progress: called at the start and after each batch.

    Raises:
        InputError: the folder cannot be used, or one of its files is damaged.
        RunError: a file could not be written, or too many workers died in a row.
    """
    folder = folder.resolve()
    size = runs_per_file(prepared, rows_per_run)
    with campaign_folder(folder, prepared, size):
        runs, every = prepared.campaign.runs, prepared.campaign.beams_every
        count = -(-runs // size)
        kept = {number for number in range(count) if part_path(folder, "runs", number).exists()}
        settings = BatchSettings(prepared.base, folder, column_kinds(prepared.campaign), every)
        progress = CampaignProgress(runs, sum(min(size, runs - k * size) for k in kept), 0)
        on_progress(progress)
        counts = CampaignCounts()
        for number in kept:
            counts.add(*stored_batch(folder, number, every))
        missing = (_batch(prepared, k, size) for k in range(count) if k not in kept)
        for batch, (reasons, tally) in _BatchScheduler(pool, settings, missing).results():
            counts.add(reasons, tally)
            failed = progress.failed + len(reasons)
            progress = CampaignProgress(runs, progress.done + len(batch.runs), failed)
            on_progress(progress)
        return progress, counts


def _batch(prepared: PreparedCampaign, number: int, size: int) -> Batch:
    runs = range(number * size, min((number + 1) * size, prepared.campaign.runs))
    return Batch(number, runs.start, [prepared.drawn.values(run) for run in runs])


class _BatchScheduler:
    """Keeps the pool busy with batches.

    When a worker dies, the batches in progress are repeated one at a time, to find the run that crashed it.
    """

    def __init__(self, pool: Pool, settings: BatchSettings, batches: Iterator[Batch]) -> None:
        self._pool, self._settings, self._batches = pool, settings, batches
        self._in_progress: dict[Future[BatchOutcome], Batch] = {}
        self._suspects: list[Batch] = []
        self._deaths_in_a_row = 0

    def results(self) -> Iterator[tuple[Batch, BatchOutcome]]:
        """Yield batches as they finish."""
        while True:
            if not self._suspects:
                self._submit()
            if self._in_progress:
                yield from self._wait()
            elif self._suspects:
                yield self._fly_alone(self._suspects.pop())
            else:
                return

    def _submit(self) -> None:
        while len(self._in_progress) < (1 + _WAITING) * self._pool.slots:
            batch = next(self._batches, None)
            if batch is None:
                return
            self._in_progress[self._pool.submit(fly_batch, self._settings, batch)] = batch

    def _wait(self) -> Iterator[tuple[Batch, BatchOutcome]]:
        for future in self._done(self._in_progress):
            batch = self._in_progress.pop(future)
            outcome = self._outcome(future)
            if outcome is None:
                self._suspects.append(batch)
            else:
                yield batch, outcome
        if self._suspects and not self._in_progress:
            self._pool.replace_workers()

    def _fly_alone(self, batch: Batch) -> tuple[Batch, BatchOutcome]:
        """Fly a batch with no other in progress; if its worker dies again, find the crashing runs and skip them."""
        while (outcome := self._run_alone(fly_batch, self._settings, batch)) is None:
            tried = zip(batch.runs, batch.values, strict=True)
            crashing = {
                run for run, values in tried if self._run_alone(probe, self._settings.base, values) is None
            }
            batch = batch._replace(crashing=batch.crashing | crashing)
        return batch, outcome

    def _run_alone(self, work: Callable[..., Any], *args: Any) -> Any:
        """Run some work with no other in progress; return its result, or None if its worker died."""
        outcome = self._outcome(self._pool.submit(work, *args))
        if outcome is None:
            self._pool.replace_workers()
        return outcome

    def _done(self, futures: Iterable[Future[Any]]) -> Iterable[Future[Any]]:
        """Wait for the first of some futures, and return those that are done."""
        while not (done := wait(futures, _CHECK_EVERY_S, FIRST_COMPLETED).done):
            self._pool.check()
        return done

    def _outcome(self, future: Future[Any]) -> Any:
        self._done([future])
        try:
            outcome = future.result()
        except self._pool.worker_errors:
            self._deaths_in_a_row += 1
            if self._deaths_in_a_row > max(_DEATHS_IN_A_ROW, 3 * self._pool.slots):
                raise RunError(
                    f"{self._deaths_in_a_row} workers died in a row; finished batches are kept"
                ) from None
            return None
        self._deaths_in_a_row = 0
        return outcome
