"""The page of a fit: verdict, figures and tables in one self-contained HTML file."""

from __future__ import annotations

from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.files import whole_file
from lidar_emu.report.html_parts import figure_element, heading, html_table, note, page_document
from lidar_emu.report.plot_style import (
    Drawing,
    beam_points,
    draw_figure,
    legend_beside,
    mark_outside,
    truth_limits,
)
from lidar_emu.sensor_fit.characteristics import in_range, quantities
from lidar_emu.sensor_fit.noise_law import Interval
from lidar_emu.sensor_fit.reference import WINDOW
from lidar_emu.sensor_fit.validation import Check, Fit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LEVELS = np.concatenate([[0.005, 0.01, 0.025], np.arange(0.05, 0.951, 0.05), [0.975, 0.99, 0.995]])


def interval_text(estimate: Interval) -> str:
    """Value and 90 % interval, or that it is not known."""
    value, low, high = estimate
    if np.isnan(value):
        return "unknown"
    if low == high:
        return f"{value:.6g}"
    if estimate.is_known:
        return f"{value:.4g} ({low:.4g} to {high:.4g})"
    return f"{value:.4g}" if np.isnan(low) else f"{value:.4g} (from {low:.4g})"


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
    rows = (
        (
            row.what,
            "all" if row.beam is None else str(row.beam),
            row.at,
            interval_text(row.estimate),
            row.unit,
            row.word,
        )
        for row in fit.sensor.rows
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
        *map(figure_element, _drawings(fit)),
        heading("Characteristics by the fitted half"),
        html_table(("figure", "beam", "at", "value (90 % interval)", "unit", "what the data say"), rows),
    ]
    with whole_file(path) as file:
        file.write(page_document(f"Fit of {fit.log.name}", parts).encode())


def _drawings(fit: Fit) -> list[Drawing]:
    law = "Quantiles, 0.5 to 99.5 %, of the held-out noise against the fitted law's; on the line they are equal."
    shares = "Shares of the shots of the fitted half, with 90 % intervals."
    log = "Ranges and closing speeds; crosses are far from the reference."
    return [
        draw_figure("log", "The log", log, 5.0, partial(_plot_log, fit)),
        draw_figure("noise", "Noise of the held-out half", law, 4.0, partial(_plot_quantiles, fit)),
        draw_figure("shares", "Values and false locks by range", shares, 3.5, partial(_plot_shares, fit)),
    ]


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
            value, false, colour = values[:, beam], quantity.is_false[:, beam], f"C{beam % 10}"
            inside = limits.contain(value)
            beam_points(axes, beam, beams, shot[inside], value[inside])
            axes.plot(shot[false & inside], value[false & inside], "x", color=colour, markersize=4)
            mark_outside(axes, colour, shot, value, limits)
    panels[1].set_xlabel("shot")


def _plot_quantiles(fit: Fit, figure: Figure) -> None:
    errors, panels = fit.sensor.errors, figure.subplots(1, 2)
    for axes, (what, unit, _, quantity) in zip(panels, quantities(fit.log, errors), strict=True):
        for each in fit.sensor.noise_bins[what]:
            inside = (
                in_range(errors, each.low_m, each.high_m)
                & errors.is_held_out
                & np.isfinite(quantity.residual)
            )
            held = quantity.residual[inside[:, each.beam], each.beam]
            if held.size:
                model = np.quantile(each.noise.drawn(errors.smoothed), _LEVELS)
                axes.plot(model, np.quantile(held, _LEVELS), ".-", color=f"C{each.beam % 10}", linewidth=0.6)
                axes.plot(model[[0, -1]], model[[0, -1]], "-", color="0.5", linewidth=0.8)
        axes.set(xlabel=f"{what} noise of the law ({unit})", ylabel=f"held out ({unit})")


def _plot_shares(fit: Fit, figure: Figure) -> None:
    panels = figure.subplots(1, 2, sharey=True)
    for axes, (what, (shares, _)) in zip(panels, fit.sensor.shares.items(), strict=True):
        middle_m = [np.sqrt(max(each.low_m, 1.0) * each.high_m) for each in shares]
        for colour, name in (("C0", "valid"), ("C3", "false")):
            value, low, high = np.array([getattr(each, name) for each in shares]).T
            axes.errorbar(middle_m, value, (value - low, high - value), fmt="o", color=colour, label=name)
        axes.set(xlabel="range (m)", ylabel=f"share of shots, {what}", xscale="log", ylim=(-0.03, 1.03))
        axes.minorticks_off()
    legend_beside(panels[-1])
