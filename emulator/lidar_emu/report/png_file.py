"""Plots as PNG files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lidar_emu.files import check_destination, check_extra, check_suffix, whole_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def check_plot_path(path: Path) -> None:
    """Check the path of a plot before a long run.

    Raises:
        InputError: the suffix is not `.png`, the folder is missing or read-only, or the extra `plots` is missing.
    """
    check_suffix(path, [".png"])
    check_extra(str(path), path.suffix, "matplotlib", "plots")
    check_destination(path)


def write_png(figure: Figure, path: Path) -> None:
    """Write a figure.

    Raises:
        RunError: writing failed.
    """
    with whole_file(path) as file:
        figure.savefig(file, format="png")
