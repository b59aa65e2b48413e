"""The statistics of a campaign on a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lidar_emu.campaign.statistics import BandStatistics, Estimate

_HEADINGS = {"altitude_m": "altitude\n\nm", "true_incidence_deg": "incidence\n\n°"}


def print_statistics(bands: Sequence[BandStatistics]) -> None:
    """A table for each axis, with the interval of the dropouts; those of the errors are in the CSV file."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console()
    for axis, heading in _HEADINGS.items():
        table = Table(box=box.SIMPLE_HEAD, padding=0)
        for column in (
            heading, "beams", "lost\n\n%", "95 % con-\nfidence\n%",
            "range\nerror\n5 %", "\n\n50 %", "\nm\n95 %", "speed\nerror\n5 %", "\n\n50 %", "\nmm/s\n95 %",
        ):  # fmt: skip
            table.add_column(column, justify="right")
        for band in (band for band in bands if band.axis == axis):
            table.add_row(
                f"{band.low:g}-{band.high:g}",
                str(band.expected),
                f"{100 * band.dropout.value:.2f}",
                f"{100 * band.dropout.low:.2f}-{100 * band.dropout.high:.2f}",
                *_values(band.quantiles["range_error_m"], 1.0),
                *_values(band.quantiles["speed_error_mps"], 1e3),
            )
        console.print(table)


def _values(estimates: Sequence[Estimate], scale: float) -> list[str]:
    return ["-" if one.value != one.value else f"{scale * one.value:.3f}" for one in estimates]
