"""The page of a fit: verdict, figures and tables in one self-contained HTML file."""

from __future__ import annotations

from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.files import whole_file
from lidar_emu.report.beam_colours import beam_colour
from lidar_emu.report.html_parts import figure_element, heading, html_table, note, page_document
from lidar_emu.report.plot_style import beam_points, draw_figure, mark_outside, truth_limits
from lidar_emu.sensor_fit.characteristics import Row, quantities
from lidar_emu.sensor_fit.reference import WINDOW
from lidar_emu.sensor_fit.validation import Check, Fit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LEVELS = np.concatenate([[0.005, 0.01, 0.025], np.arange(0.05, 0.951, 0.05), [0.975, 0.99, 0.995]])


def row_texts(row: Row) -> tuple[str, str, str, str, str]:
    """Cells of a line of the result: figure, where, value and 90 % interval, unit, what the data say."""
    at = row.at if row.beam is None else f"beam {row.beam} {row.at}".strip()
    value, low, high = row.estimate
    text = f"{value:.6g}" if low == high else f"{value:.4g} ({low:.4g} to {high:.4g})"
    if not row.estimate.is_known:
        text = f"{value:.4g}" if np.isnan(low) else f"{value:.4g} (from {low:.4g})"
    return row.what, at, "unknown" if np.isnan(value) else text, row.unit, row.word


def check_texts(check: Check) -> tuple[str, str, str, str]:
    """Cells of a line of the verdict: figure, value, band, whether it is inside."""
    value, band = f"{check.value:.4g} {check.unit}".strip(), f"{check.low:.4g} to {check.high:.4g}"
    return check.what, value, band, "inside" if check.inside else "OUTSIDE"


def verdict_line(fit: Fit) -> str:
    """How many figures of the held-out half are as the fitted half predicts."""
    inside = sum(check.inside for check in fit.checks)
    more = f"; {fit.unfitted} values in bins of range with too little to fit" if fit.unfitted else ""
    return f"{inside} of {len(fit.checks)} figures of the held-out half are inside their 90 % bands{more}"


def write_fit_page(path: Path, fit: Fit) -> None:
    """Write the page.

    Raises:
        InputError: the file cannot be written.
        RunError: writing failed.
    """
    shots, beams = fit.log.time_s.shape
    reference = "the ground truth of the log"
    if fit.sensor.errors.smoothed:
        reference = f"the motion smoothed from the values, a quadratic over {WINDOW} shots"
    law = "Quantiles, 0.5 to 99.5 %, of the held-out noise against the fitted law's; on the line they are equal."
    points = "Ranges and closing speeds; crosses are far from the reference."
    drawings = (
        draw_figure("log", "The log", points, 5.0, partial(_plot_log, fit)),
        draw_figure("noise", "Noise of the held-out half", law, 4.0, partial(_plot_quantiles, fit)),
    )
    parts = [
        heading(f"Fit of {fit.log.name}", 1),
        note(
            f"{shots} shots of {beams} beams. Reference: {reference}. "
            "Every second block is fitted, the blocks between are held out."
        ),
        heading("Verdict on the held-out half"),
        f"<p>{escape(verdict_line(fit))}.</p>",
        html_table(("figure", "held out", "90 % band", "verdict"), map(check_texts, fit.checks)),
        *map(figure_element, drawings),
        heading("Characteristics by the fitted half"),
        html_table(("figure", "at", "value (90 %)", "unit", "note"), map(row_texts, fit.sensor.rows)),
    ]
    with whole_file(path) as file:
        file.write(page_document(f"Fit of {fit.log.name}", parts).encode())


def _plot_log(fit: Fit, figure: Figure) -> None:
    panels, beams = figure.subplots(2, 1, sharex=True), fit.log.time_s.shape[1]
    # By shots: a log may leave out minutes.
    shot = np.arange(len(fit.log.time_s), dtype=np.float64)
    for axes, (what, unit, values, quantity) in zip(
        panels, quantities(fit.log, fit.sensor.errors), strict=True
    ):
        limits = truth_limits(values, quantity.reference)
        axes.set(ylabel=f"{what} ({unit})", ylim=limits)
        for beam in range(beams):
            value, false, colour = values[:, beam], quantity.is_false[:, beam], beam_colour(beam)
            inside = limits.contain(value)
            beam_points(axes, beam, beams, shot[inside], value[inside])
            axes.plot(shot[false & inside], value[false & inside], "x", color=colour, markersize=4)
            mark_outside(axes, colour, shot, value, limits)
    panels[1].set_xlabel("shot")


def _plot_quantiles(fit: Fit, figure: Figure) -> None:
    errors, panels = fit.sensor.errors, figure.subplots(1, 2)
    for axes, (what, unit, _, quantity) in zip(panels, quantities(fit.log, errors), strict=True):
        for each in fit.sensor.noise_bins[what]:
            held = quantity.residual[each.holds(errors) & errors.is_held_out & np.isfinite(quantity.residual)]
            if held.size:
                model = np.quantile(each.noise.drawn(errors.smoothed), _LEVELS)
                axes.plot(
                    model, np.quantile(held, _LEVELS), ".-", color=beam_colour(each.beam), linewidth=0.6
                )
                axes.plot(model[[0, -1]], model[[0, -1]], "-", color="0.5", linewidth=0.8)
        axes.set(xlabel=f"{what} noise of the law ({unit})", ylabel=f"held out ({unit})")
