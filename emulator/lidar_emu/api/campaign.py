"""A Monte Carlo campaign from Python."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from lidar_emu.campaign.pools import LocalPool, usable_cores
from lidar_emu.campaign.read import prepare
from lidar_emu.campaign.run import compile_kernels, fly_campaign
from lidar_emu.campaign.statistics import BandStatistics, campaign_statistics
from lidar_emu.errors import InputError
from lidar_emu.files import check_extra
from lidar_emu.scenario.plain_values import changed_keys

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class CampaignResults:
    """The results of a campaign, in the tables of its folder."""

    folder: Path
    runs: int
    """Runs, including failed ones."""
    failed: int
    """Failed runs of this call; the column `failed` of the table `runs` has the reasons of all."""

    def table(self, name: Literal["runs", "beams"], columns: list[str] | None = None) -> pa.Table:
        """Read a table: `runs` has a row per run, `beams` a row per run, shot and beam (docs/columns.md).

        Args:
            name: name of the table.
            columns: names of the columns to read; None: all.
        """
        import pyarrow.dataset as dataset

        return dataset.dataset(self.folder / name).to_table(columns=columns)

    def statistics(self) -> list[BandStatistics]:
        """Dropouts and errors by altitude and incidence, with their confidence."""
        return campaign_statistics(self.folder)


def run_campaign(
    campaign: str | PathLike[str] | Mapping[str, Any],
    folder: str | PathLike[str],
    overrides: Mapping[str, Any] | None = None,
    *,
    runs: int | None = None,
    workers: int | None = None,
) -> CampaignResults:
    """Fly a campaign on this machine, or the runs of it that `folder` does not hold yet.

    A script that calls this needs `if __name__ == "__main__":`, since each worker imports it.

    Args:
        campaign: path of its YAML file; the name of a shipped campaign; or a mapping with the keys of a file, whose
            scenario is a shipped one's name or a path relative to the working directory.
        folder: folder of the results.
        overrides: dotted keys and values that all runs have instead of the scenario's, see `load`.
        runs: number of runs; None: the campaign's.
        workers: number of processes; None: one per core.

    Raises:
        InputError: the campaign, its scenario or the folder cannot be used, or pyarrow is not installed.
        RunError: a file could not be written, or too many workers died in a row.
    """
    check_extra("run_campaign", "tables", "pyarrow", "tables")
    for name, count in (("runs", runs), ("workers", workers)):
        if count is not None and (isinstance(count, bool) or not isinstance(count, int) or count < 1):
            raise InputError("run_campaign", name, count, "must be a whole number above 0")
    if not isinstance(campaign, str | PathLike | Mapping):
        allowed = "must be a path, the name of a shipped campaign, or a mapping"
        raise InputError("run_campaign", "campaign", campaign, allowed)
    stated = campaign if isinstance(campaign, Mapping) else Path(campaign)
    prepared = prepare(stated, changed_keys(overrides, {}), runs)
    beams = compile_kernels(prepared)
    slots = usable_cores() if workers is None else workers
    progress = fly_campaign(prepared, beams, Path(folder), lambda: LocalPool(slots), lambda _: None)
    return CampaignResults(Path(folder), progress.runs, progress.failed)
