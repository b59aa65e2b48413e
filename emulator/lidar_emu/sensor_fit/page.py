"""The page of a fit: verdict, figures and tables in one self-contained HTML file."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.files import whole_file
from lidar_emu.report.html_parts import figure_element, html_table, page_document
from lidar_emu.report.plot_style import (
    Drawing,
    beam_points,
    draw_figure,
    legend_beside,
    mark_outside,
    truth_limits,
)
from lidar_emu.sensor_fit.characteristics import RangeShare
from lidar_emu.sensor_fit.noise_law import Interval
from lidar_emu.sensor_fit.reference import WINDOW
from lidar_emu.sensor_fit.validation import Fit, NoiseVerdict, model_noise

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LEVELS = np.concatenate([[0.005, 0.01, 0.025], np.arange(0.05, 0.951, 0.05), [0.975, 0.99, 0.995]])


def interval_text(estimate: Interval) -> str:
    """Value and 90 % interval, or that it is not known."""
    if np.isnan(estimate.value):
        return "unknown"
    if not estimate.is_known:
        return (
            f"{estimate.value:.4g}"
            if np.isnan(estimate.low)
            else f"{estimate.value:.4g} (from {estimate.low:.4g})"
        )
    if estimate.low == estimate.high:
        return f"{estimate.value:.6g}"
    return f"{estimate.value:.4g} ({estimate.low:.4g} to {estimate.high:.4g})"


def verdict_line(fit: Fit) -> str:
    """How many figures of the held-out half are as the fitted half predicts."""
    checks = fit.checks
    inside = sum(check.inside for check in checks)
    unfitted = sum(noise.unfitted for noise in fit.noise)
    more = f"; {unfitted} values in bins of range with too little to fit" if unfitted else ""
    return f"{inside} of {len(checks)} figures of the held-out half are inside their 90 % bands{more}"


def write_fit_page(path: Path, fit: Fit) -> None:
    """Write the page.

    Raises:
        InputError: the file cannot be written.
        RunError: writing failed.
    """
    checks = (
        (
            c.what,
            f"{c.value:.4g} {c.unit}".strip(),
            f"{c.low:.4g} to {c.high:.4g}",
            "inside" if c.inside else "OUTSIDE",
        )
        for c in fit.checks
    )
    rows = (
        (r.what, "all" if r.beam is None else str(r.beam), r.at, interval_text(r.estimate), r.unit, r.word)
        for r in fit.sensor.rows
    )
    compared = (
        f"Reference: the motion smoothed from the values, a quadratic over {WINDOW} shots."
        if fit.sensor.errors.smoothed
        else "Reference: the ground truth of the log."
    )
    parts = [
        f"<h1>Fit of {escape(fit.log.name)}</h1>",
        f'<p class="note">{len(fit.log.time_s)} shots of {fit.log.time_s.shape[1]} beams. {compared} '
        "Every second block is fitted, the blocks between are held out.</p>",
        "<h2>Verdict on the held-out half</h2>",
        f"<p>{escape(verdict_line(fit))}.</p>",
        html_table(("figure", "held out", "90 % band", "verdict"), checks),
        *(figure_element(drawing) for drawing in _drawings(fit)),
        "<h2>Characteristics by the fitted half</h2>",
        html_table(("figure", "beam", "at", "value (90 % interval)", "unit", "what the data say"), rows),
    ]
    with whole_file(path) as file:
        file.write(page_document(f"Fit of {fit.log.name}", parts).encode())


def _drawings(fit: Fit) -> list[Drawing]:
    return [
        draw_figure("log", "The log", "Ranges and closing speeds; crosses are far from the reference.", 5.0,
                    lambda figure: _plot_log(figure, fit)),
        draw_figure("noise", "Noise of the held-out half", "Quantiles of the held-out noise against those of the "
                    "fitted law, from 0.5 to 99.5 %; on the line they are equal.", 4.0,
                    lambda figure: _plot_quantiles(figure, fit)),
        draw_figure("by_range", "Noise by range", "Robust standard deviation of each beam by the fitted half, with its "
                    "90 % interval.", 3.5, lambda figure: _plot_by_range(figure, fit)),
        draw_figure("shares", "Values and false locks by range", "Shares of the shots: fitted half with 90 % interval, "
                    "held-out half as crosses.", 3.5, lambda figure: _plot_shares(figure, fit)),
        draw_figure("correlation", "Correlation from shot to shot", "Correlation of the held-out noise, with the band "
                    "in which white noise would be.", 3.0, lambda figure: _plot_correlation(figure, fit)),
    ]  # fmt: skip


def _plot_log(figure: Figure, fit: Fit) -> None:
    log, beams = fit.log, fit.log.time_s.shape[1]
    panels = figure.subplots(2, 1, sharex=True)
    for axes, label, values, quantity in (
        (panels[0], "range (m)", log.range_m, fit.sensor.errors.range),
        (panels[1], "closing speed (m/s)", log.closing_speed_mps, fit.sensor.errors.speed),
    ):
        limits = truth_limits(values, quantity.reference)
        axes.set(ylabel=label, ylim=limits)
        for beam in range(beams):
            # By shots: a log may leave out minutes.
            shot, value = np.arange(len(values), dtype=np.float64), values[:, beam]
            inside, false = limits.contain(value), quantity.is_false[:, beam]
            beam_points(axes, beam, beams, shot[inside], value[inside])
            axes.plot(shot[false & inside], value[false & inside], "x", color=f"C{beam % 10}", markersize=4)
            mark_outside(axes, f"C{beam % 10}", shot, value, limits)
    panels[1].set_xlabel("shot")


def _each(figure: Figure, fit: Fit) -> list[tuple[NoiseVerdict, Axes]]:
    return list(zip(fit.noise, figure.subplots(1, len(fit.noise), squeeze=False)[0], strict=True))


def _plot_quantiles(figure: Figure, fit: Fit) -> None:
    for noise, axes in _each(figure, fit):
        for number, each in enumerate(noise.bins):
            held = noise.held_out.residual[noise.held_out.group == number]
            if not len(held):
                continue
            model = np.quantile(model_noise(each, fit.sensor.errors.smoothed), _LEVELS)
            axes.plot(model, np.quantile(held, _LEVELS), ".-", color=f"C{each.beam % 10}", linewidth=0.6)
            axes.plot(model[[0, -1]], model[[0, -1]], "-", color="0.5", linewidth=0.8)
        axes.set(xlabel=f"{noise.what} noise of the law ({noise.unit})", ylabel=f"held out ({noise.unit})")


def _plot_by_range(figure: Figure, fit: Fit) -> None:
    for noise, axes in _each(figure, fit):
        for each in noise.bins:
            sigma, middle_m = (
                each.noise.sigma,
                np.sqrt(max(each.low_m, 1.0) * each.high_m) * (1 + 0.02 * each.beam),
            )
            axes.plot([middle_m] * 2, [sigma.low, sigma.high], "-", color=f"C{each.beam % 10}", linewidth=1)
            axes.plot(middle_m, sigma.value, "o", color=f"C{each.beam % 10}", markersize=4)
        axes.set(xlabel="range (m)", ylabel=f"{noise.what} noise ({noise.unit})", xscale="log", yscale="log")


def _plot_shares(figure: Figure, fit: Fit) -> None:
    panels = figure.subplots(1, len(fit.sensor.shares), sharey=True, squeeze=False)[0]
    for axes, (what, (fitted, held_out)) in zip(panels, fit.sensor.shares.items(), strict=True):
        for colour, name in (("C0", "valid"), ("C3", "false")):
            for k, (half, style) in enumerate(((fitted, "o"), (held_out, "x"))):
                known = [each for each in half if each.shots]
                middle_m = [_middle(each) for each in known]
                label = name if not k else None
                axes.plot(
                    middle_m, [getattr(each, name).value for each in known], style, color=colour, label=label
                )
                if not k:
                    low, high = zip(*(getattr(each, name)[1:] for each in known), strict=True)
                    axes.vlines(middle_m, low, high, color=colour, linewidth=1)
        axes.set(xlabel="range (m)", ylabel=f"share of shots, {what}", xscale="log", ylim=(-0.03, 1.03))
        axes.minorticks_off()
    legend_beside(panels[-1])


def _middle(each: RangeShare) -> float:
    return float(np.sqrt(max(each.low_m, 1.0) * each.high_m))


def _plot_correlation(figure: Figure, fit: Fit) -> None:
    for noise, axes in _each(figure, fit):
        lag = np.arange(1, len(noise.correlation) + 1)
        low, high = (noise.expected_correlation + sign * noise.correlation_half for sign in (-1, 1))
        axes.fill_between(lag, low, high, color="0.5", alpha=0.3, linewidth=0)
        axes.plot(lag, noise.correlation, "o", color="C0")
        axes.set(xlabel="shots apart", ylabel=f"correlation, {noise.what}", ylim=(-1, 1))
