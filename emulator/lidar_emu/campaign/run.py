"""Fly a campaign: send batches to a pool, survive workers that die, store every run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import Any, NamedTuple

from lidar_emu.campaign.batch import Batch, BatchSettings, fly_batch, probe
from lidar_emu.campaign.folder import campaign_folder, finished
from lidar_emu.campaign.pools import Pool
from lidar_emu.campaign.read import PreparedCampaign
from lidar_emu.campaign.tables import column_kinds
from lidar_emu.errors import RunError

_ROWS_PER_FILE = 500_000
_LEAST_FILES = 256
_MOST_RUNS_PER_FILE = 256
_WAITING = 1
"""Batches queued per worker, so that none idles."""
_DEATHS_IN_A_ROW = 16


class CampaignProgress(NamedTuple):
    """Progress of a campaign."""

    runs: int
    done: int
    """Stored runs, including failed ones and those of an earlier start."""
    failed: int
    """Failed runs of this start."""


def runs_per_file(prepared: PreparedCampaign, rows_per_run: int) -> int:
    """So few that all workers have work, so many that files are of a sane size; of the campaign alone."""
    rows = max(1, rows_per_run // prepared.campaign.beams_every)
    return max(1, min(prepared.campaign.runs // _LEAST_FILES, _ROWS_PER_FILE // rows, _MOST_RUNS_PER_FILE))


def fly_campaign(
    prepared: PreparedCampaign,
    rows_per_run: int,
    folder: Path,
    make_pool: Callable[[], Pool],
    on_progress: Callable[[CampaignProgress], None],
) -> CampaignProgress:
    """Fly all runs that `folder` does not hold yet.

    Args:
        prepared: the campaign.
        rows_per_run: beams of all shots of a run, about.
        folder: where everything is kept; another start with the same one goes on.
        make_pool: called if there is something to fly.
        on_progress: called at the start and after each batch.

    Raises:
        InputError: the folder cannot be used.
        RunError: a file could not be written, or workers die whatever they do.
    """
    folder = folder.resolve()
    size = runs_per_file(prepared, rows_per_run)
    with campaign_folder(folder, prepared, size):
        runs = prepared.campaign.runs
        count = -(-runs // size)
        kept = finished(folder, count)
        settings = BatchSettings(
            prepared.base, folder, column_kinds(prepared.campaign), prepared.campaign.beams_every
        )
        progress = CampaignProgress(runs, sum(min(size, runs - k * size) for k in kept), 0)
        on_progress(progress)
        if len(kept) == count:
            return progress
        missing = (_batch(prepared, k, size) for k in range(count) if k not in kept)
        pool = make_pool()
        try:
            for batch, failed in _Flying(pool, settings, missing).results():
                progress = CampaignProgress(runs, progress.done + len(batch.runs), progress.failed + failed)
                on_progress(progress)
        finally:
            pool.stop()
        return progress


def _batch(prepared: PreparedCampaign, number: int, size: int) -> Batch:
    runs = range(number * size, min((number + 1) * size, prepared.campaign.runs))
    return Batch(number, runs.start, [prepared.drawn.values(run) for run in runs])


class _Flying:
    """Batches on their way. Those that were with a process that died are flown again one at a time, to see which."""

    def __init__(self, pool: Pool, settings: BatchSettings, batches: Iterator[Batch]) -> None:
        self._pool, self._settings, self._batches = pool, settings, batches
        self._flying: dict[Future[int], Batch] = {}
        self._suspects: list[Batch] = []
        self._deaths_in_a_row = 0

    def results(self) -> Iterator[tuple[Batch, int]]:
        """Batches as they are done, with the number of runs that failed."""
        while True:
            if not self._suspects:
                self._send()
            if self._flying:
                yield from self._landed()
            elif self._suspects:
                yield self._alone(self._suspects.pop())
            else:
                return

    def _send(self) -> None:
        while len(self._flying) < (1 + _WAITING) * self._pool.slots:
            batch = next(self._batches, None)
            if batch is None:
                return
            self._flying[self._pool.submit(fly_batch, self._settings, batch)] = batch

    def _landed(self) -> Iterator[tuple[Batch, int]]:
        for future in wait(self._flying, return_when=FIRST_COMPLETED).done:
            batch = self._flying.pop(future)
            failed = self._outcome(future)
            if failed is None:
                self._suspects.append(batch)
            else:
                yield batch, failed
        if self._suspects and not self._flying:
            self._pool.mend()

    def _alone(self, batch: Batch) -> tuple[Batch, int]:
        """A batch with nothing beside it; if that is deadly too, its runs one by one, and then without the deadly."""
        while (failed := self._by_itself(fly_batch, self._settings, batch)) is None:
            tried = zip(batch.runs, batch.values, strict=True)
            deadly = {
                run for run, values in tried if self._by_itself(probe, self._settings.base, values) is None
            }
            batch = batch._replace(deadly=batch.deadly | deadly)
        return batch, failed

    def _by_itself(self, work: Callable[..., int], *args: Any) -> int | None:
        """What comes of some work while there is no other; None: the death of its process."""
        outcome = self._outcome(self._pool.submit(work, *args))
        if outcome is None:
            self._pool.mend()
        return outcome

    def _outcome(self, future: Future[int]) -> int | None:
        try:
            outcome = future.result()
        except self._pool.deaths:
            self._deaths_in_a_row += 1
            if self._deaths_in_a_row > max(_DEATHS_IN_A_ROW, 3 * self._pool.slots):
                raise RunError(
                    f"{self._deaths_in_a_row} workers died in a row; what is done is kept"
                ) from None
            return None
        self._deaths_in_a_row = 0
        return outcome
