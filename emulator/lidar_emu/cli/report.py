"""`lidar-emu report`: pages about what was flown."""

from __future__ import annotations

from pathlib import Path

import click

from lidar_emu.cli.progress import COMPILING, busy
from lidar_emu.errors import Finding, InputError


@click.command(short_help="Figures 2 to 5 of the published simulation, drawn again.")
@click.option(
    "--paper-figure", metavar="2|3|4|5", help="Draw this figure of Budge et al. from its own scenario."
)
@click.option("--out", metavar="FILE.png", help="Where to; left out: paper_figN.png.")
def report(paper_figure: str | None, out: str | None) -> None:
    """Draw what was flown.

    \b
    lidar-emu report --paper-figure 2
    lidar-emu report --paper-figure 5 --out slant.png
    """
    if paper_figure is None:
        raise InputError("report", None, Finding("nothing to report"), "allowed: --paper-figure 2, 3, 4 or 5")
    draw_paper_figure(paper_figure, out)


def draw_paper_figure(figure: str, out: str | None) -> None:
    """Draw figure `2`, `3`, `4` or `5`.

    Raises:
        InputError: another figure, or a file that cannot be written.
        RunError: writing failed on the way.
    """
    if figure not in ("2", "3", "4", "5"):
        raise InputError("--paper-figure", None, figure, "allowed: 2, 3, 4 or 5")
    from lidar_emu.report.paper_figures import plot_paper_figure

    path = Path(f"paper_fig{figure}.png" if out is None else out)
    with busy(COMPILING):
        plot_paper_figure(figure, path)
    click.echo(f"{path}: figure {figure} of Budge et al.")
