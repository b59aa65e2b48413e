"""`lidar-emu report --paper-figure`: figures of the published simulation, drawn again."""

from __future__ import annotations

from pathlib import Path

import click

from lidar_emu.cli.progress import COMPILING, busy
from lidar_emu.errors import InputError


def draw_paper_figure(figure: str, out: str | None) -> None:
    """Draw figure `2`, `3`, `4` or `5`.

    Raises:
        InputError: another figure, or a file that cannot be written.
        RunError: writing failed on the way.
    """
    if figure not in ("2", "3", "4", "5"):
        raise InputError("--paper-figure", None, figure, "allowed: 2, 3, 4 or 5")
    from lidar_emu.report.paper_figures import errors_of, plot_paper_figure

    path = Path(f"paper_fig{figure}.png" if out is None else out)
    with busy(COMPILING):
        errors = errors_of(plot_paper_figure(figure, path))
    click.echo(f"{path}: figure {figure} of Budge et al., {errors.measured} of {errors.asked} beams measured")
    click.echo(
        f"range error: mean {errors.range_mean_m:+.4f} m, standard deviation {errors.range_deviation_m:.4f} m"
    )
    click.echo(
        f"speed error: mean {1e3 * errors.speed_mean_mps:+.4f} mm/s, "
        f"standard deviation {1e3 * errors.speed_deviation_mps:.4f} mm/s"
    )
