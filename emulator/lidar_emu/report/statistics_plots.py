"""Plots of statistics: campaigns, detection forecasts, and error against run time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.plan.detection_forecast import DetectionForecast
from lidar_emu.report.beam_colours import BEAM_COLOURS, beam_colour
from lidar_emu.report.plot_style import (
    GRID,
    INK,
    Limits,
    check_plot_path,
    mark_outside,
    number_log_axis,
    styled,
    titled_figure,
    write_plot,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes


LEAST_SHARE = 0.05
"""Share of the flights that a band needs to be drawn."""
_CAMPAIGN_NOTE = (
    "A beam shot is a shot of one beam at the ground, with or without a value. "
    f"Bands that fewer than {100 * LEAST_SHARE:g} % of the flights reach are left out."
)


@dataclass(frozen=True)
class CampaignColumn:
    """Data of one column of panels. The last axis of each array of estimates is (value, low, high)."""

    label: str
    logarithmic: bool
    middle: FloatArray
    """(bands,) Where a band is drawn."""
    counts: dict[str, list[int]]
    """What the estimates of each band are made from, by name."""
    dropout: FloatArray
    """(bands, 3)"""
    quantiles: dict[str, FloatArray]
    """Quantiles (levels, bands, 3) by the label of the error."""


@styled
def plot_campaign(columns: Sequence[CampaignColumn], levels: Sequence[str], title: str, path: Path) -> None:
    """Plot a PNG of 1100 by 1050 pixels: a column per axis; dropout rate, quantiles of errors, and counts.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    figure = titled_figure(title, (8.8, 8.4), 12)
    labels = list(columns[0].quantiles)
    how: dict[str, Any] = {"height_ratios": [1.0, *(1.2 for _ in labels), 0.8], "squeeze": False}
    panels = figure.subplots(2 + len(labels), len(columns), sharex="col", sharey="row", **how)
    for column, (lost, *errors, counted) in zip(columns, panels.T, strict=True):
        _draw_bands(lost, column, 100.0 * column.dropout, "C3", None)
        for axes, label in zip(errors, labels, strict=True):
            for i, level in enumerate(levels):
                _draw_bands(axes, column, column.quantiles[label][i], f"C{i}", level)
        for i, (label, counts) in enumerate(column.counts.items()):
            counted.plot(column.middle, counts, color=f"C{4 + i}", marker=".", linewidth=1.2, label=label)
        counted.set(xlabel=column.label, yscale="log")
        if column.logarithmic:
            number_log_axis(counted.xaxis)
            counted.xaxis.minorticks_off()
    dropouts = 100.0 * np.concatenate([column.dropout for column in columns])
    least, most = 3.0 * dropouts[:, 0].max(initial=0.0), 1.1 * dropouts[:, 2].max(initial=0.0)
    panels[0, 0].set(ylabel="dropouts (%)", ylim=(0.0, min(least, most) or 1.0))
    for axes, label in zip(panels[1:-1, 0], labels, strict=True):
        # Bands of mostly false locks, with errors of kilometres, must not set the scale.
        values = np.concatenate([np.abs(column.quantiles[label][..., 0]).ravel() for column in columns])
        largest = float(np.percentile(values[np.isfinite(values)], 90)) if np.isfinite(values).any() else 0.0
        axes.set(ylabel=label, ylim=(-1.5 * largest, 1.5 * largest) if largest > 0 else None)
    panels[-1, 0].set(ylabel="number in a band")
    for axes in panels[:, -1]:
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), reverse=True)
    figure.supxlabel(_CAMPAIGN_NOTE, fontsize=9)
    write_plot(figure, path)


def _draw_bands(
    axes: Axes, column: CampaignColumn, estimate: FloatArray, colour: str, label: str | None
) -> None:
    value, least, most = estimate.T
    shaded = None if label else "95 % confidence"
    axes.fill_between(column.middle, least, most, color=colour, alpha=0.25, linewidth=0, label=shaded)
    axes.plot(column.middle, value, color=colour, marker=".", linewidth=1.2, label=label)
    if column.logarithmic:
        axes.set_xscale("log")


_SENSITIVITY_NOTE = (
    "Full colour, first-order index: the share of the variance that a source of scatter explains alone. Faded,\n"
    "total index: its share with all interactions with other sources. Lines: 95 % confidence, triangles where they\n"
    "go on. Estimates from few samples may be below 0 or above 1. In brackets: samples in a band that not all reach."
)
_SHARES = Limits(-0.6, 1.8)
"""Limits of the shares in a plot; values beyond widen them, intervals do not."""


class SensitivityPanel(NamedTuple):
    """Sobol indices of one output. The last axis of the arrays is (value, low, high)."""

    label: str
    bands: list[str]
    first: FloatArray
    """(bands, factors, 3)"""
    total: FloatArray
    """(bands, factors, 3)"""


@styled
def plot_sensitivity(
    panels: Sequence[SensitivityPanel], factors: Sequence[str], title: str, path: Path
) -> None:
    """Plot bars with intervals: a row per output that has indices; total ones are faded, first ones lie on them.

    Raises:
        InputError: see `check_plot_path`; or no output has indices.
        RunError: writing failed.
    """
    check_plot_path(path)
    panels = [panel for panel in panels if panel.bands]
    if not panels:
        raise InputError(title, None, Finding("no output that varies"), "draw keys that change the runs")
    figure = titled_figure(title, (8.8, 1.55 * len(panels) + 2.4), 12)
    rows = figure.subplots(len(panels), squeeze=False)[:, 0]
    for axes, panel, below in zip(rows, panels, [*panels[1:], None], strict=True):
        _draw_indices(axes, panel, factors)
        axes.tick_params(labelbottom=below is None or below.bands != panel.bands)
    rows[-1].set_xlabel("altitude (m)")
    entries = rows[0].get_legend_handles_labels()
    figure.legend(*entries, loc="outside lower center", ncols=2, title=_SENSITIVITY_NOTE)
    write_plot(figure, path)


def _draw_indices(axes: Axes, panel: SensitivityPanel, factors: Sequence[str]) -> None:
    """Draw a group of bars per band, a bar per factor; those that repeat a colour are hatched."""
    width, place = 0.84 / len(factors), np.arange(len(panel.bands))
    values = np.concatenate([panel.total[..., 0].ravel(), panel.first[..., 0].ravel(), _SHARES])
    limits = Limits(1.04 * float(np.nanmin(values)), 1.04 * float(np.nanmax(values)))
    for k, factor in enumerate(factors):
        middle = place + (k - (len(factors) - 1) / 2) * width
        hatch = "//" if k >= len(BEAM_COLOURS) else None
        how: dict[str, Any] = {"width": 0.9 * width, "color": beam_colour(k), "hatch": hatch}
        for indices, alpha, aside in ((panel.total, 0.35, 0.18), (panel.first, 1.0, -0.18)):
            value, low, high = indices[:, k].T
            axes.bar(middle, value, alpha=alpha, label=factor if alpha == 1.0 else None, **how)
            at = np.asarray(middle + aside * width, dtype=np.float64)
            axes.vlines(at, np.maximum(low, limits.low), np.minimum(high, limits.high), INK, linewidth=0.7)
            for end in (low, high):
                mark_outside(axes, INK, at, end, limits)
    axes.set_xticks(place, panel.bands)
    axes.set_title(panel.label, loc="left", fontsize=9.5)
    axes.set(ylabel="share of variance", ylim=limits, xlim=(-0.5, len(place) - 0.5))
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.grid(visible=False, axis="x")
    for between in place[1:] - 0.5:
        axes.axvline(between, color=GRID, linewidth=0.6)


_DETECTION_INCH = (12.8, 8.8)
_ANGLES_IN_LEGEND = 12
_LEAST_PROBABILITY = 1e-6

_Curve = tuple[str, Literal["-", "--", ":"], FloatArray]
"""Label, line style and probabilities (angles, altitudes)."""


@styled
def plot_detection(forecast: DetectionForecast, title: str, path: Path) -> None:
    """Plot a forecast as a PNG of 1600 by 1100 pixels: a colour per beam angle, a line style per fading model.

    Raises:
        InputError: see `check_plot_path`; or the ground is beyond the maximum range at every altitude.
        RunError: writing failed.
    """
    check_plot_path(path)
    if not np.isfinite(forecast.snr_db).any():
        remedy = "choose altitudes from which the ground is within detection.maximum_range_m"
        raise InputError(title, None, Finding("no beam with an echo"), remedy)
    figure = titled_figure(title, _DETECTION_INCH, 14)
    snr, measured, false_lock = figure.subplots(3, 1, sharex=True)
    _add_snr(snr, forecast)
    _add_curves(
        measured,
        forecast,
        (
            ("steady", "-", forecast.measurement_steady),
            ("speckle, independent segments", "--", forecast.measurement_independent),
            ("speckle, shared by segments", ":", forecast.measurement_shared),
        ),
    )
    _add_curves(
        false_lock,
        forecast,
        (("steady", "-", forecast.false_lock_steady), ("speckle", "--", forecast.false_lock_speckle)),
    )
    measured.set(ylabel="P(measurement detected)", ylim=(-0.02, 1.02))
    false_lock.set(ylabel="P(false lock) per segment", yscale="log", ylim=(_LEAST_PROBABILITY, 1.5))
    false_lock.set_xlabel("altitude (m)")
    snr.set(xscale="log", xlim=(forecast.altitude_m[0], forecast.altitude_m[-1]))
    write_plot(figure, path)


def _add_snr(axes: Axes, forecast: DetectionForecast) -> None:
    for i, angle_deg in enumerate(forecast.angle_deg):
        axes.plot(
            forecast.altitude_m, forecast.snr_db[i], color=f"C{i % 10}", label=f"{angle_deg:g}° off nadir"
        )
    threshold_db = 10.0 * np.log10(forecast.minus_log_pfa)
    axes.axhline(threshold_db, color=GRID, linewidth=0.8, zorder=1, label="threshold of one look")
    axes.set_ylabel("bin SNR (dB)")
    if len(forecast.angle_deg) <= _ANGLES_IN_LEGEND:
        axes.legend(loc="upper left", bbox_to_anchor=(1.005, 1.03), frameon=False)


def _add_curves(axes: Axes, forecast: DetectionForecast, curves: tuple[_Curve, ...]) -> None:
    from matplotlib.lines import Line2D

    for _, style, probability in curves:
        for i in range(len(forecast.angle_deg)):
            axes.plot(forecast.altitude_m, probability[i], style, color=f"C{i % 10}")
    handles = [Line2D([], [], color=INK, linestyle=style, label=label) for label, style, _ in curves]
    axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.005, 1.03), frameon=False)


_WORK_PRECISION_NOTE = (
    "Errors are differences from the reference: rms over the quantiles (1 to 99 %) of measurement errors,\n"
    "and shares of dropouts and false locks. Those below the sampling noise are drawn at its edge.\n"
    "Numbers are beamlets, the rays that sample a footprint: 1, 7, 19, 37, 61 or 127. Skip rules leave out stages\n"
    "whose effect is a small share of sigma. No setting beats those on the Pareto front in both time and error."
)
_MARKERS = "osD^vP"
_ASIDE_POINTS = [
    (distance * across, distance * up)
    for distance in (13, 20)
    for across, up in ((0, -1), (0, 1), (-1, 0), (1, 0), (-0.7, -0.7), (0.7, 0.7), (0.7, -0.7), (-0.7, 0.7))
]
"""Places of a label around its mark, the best first."""


class Mark(NamedTuple):
    """One setting with its error and computing time."""

    family: str
    """Settings of a family share colour and marker."""
    label: str
    time_s: float
    error: float
    """0 for the reference, by definition."""
    on_front: bool
    is_default: bool


@styled
def plot_work_precision(panels: Sequence[tuple[str, Sequence[Mark], float]], title: str, path: Path) -> None:
    """Plot a PNG of 1100 by 650 pixels: a panel for each error, its unit, the settings, and the sampling noise.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    figure = titled_figure(title, (8.8, 5.2), 12)
    columns = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, (name, marks, noise) in zip(columns, panels, strict=True):
        _add_panel(axes, marks, noise)
        axes.set_title(name, loc="left", fontsize=10)
    entries = columns[0].get_legend_handles_labels()
    figure.legend(*entries, loc="outside lower center", ncols=4, title=_WORK_PRECISION_NOTE)
    figure.draw_without_rendering()
    for axes, (_, marks, _) in zip(columns, panels, strict=True):
        if placed := [mark for mark in marks if mark.error > 0.0]:
            _label_marks(axes, placed)
    write_plot(figure, path)


def _add_panel(axes: Axes, marks: Sequence[Mark], noise: float) -> None:
    placed = [mark for mark in marks if mark.error > 0.0]
    times_s, errors = [mark.time_s for mark in placed] or [1.0], [mark.error for mark in placed] or [1.0]
    axes.set(xscale="log", yscale="log", xlabel="time per beam measurement (µs)")
    lowest = min(0.3 * min(errors), 0.6 * noise if noise > 0.0 else 1.0)
    axes.set(xlim=(0.75 * min(times_s), 1.5 * max(times_s)), ylim=(lowest, 2.0 * max(errors)))
    for axis in (axes.xaxis, axes.yaxis):
        number_log_axis(axis)
    axes.minorticks_off()
    axes.xaxis.set_major_formatter(lambda time_s, _: f"{1e6 * time_s:g}")
    front = sorted((mark.time_s, mark.error) for mark in placed if mark.on_front)
    axes.plot(*zip(*front, strict=True), color=GRID, linewidth=1.2, zorder=1, label="Pareto front")
    axes.axhspan(lowest, noise, color=GRID, alpha=0.2, linewidth=0, label="sampling noise")
    ringed = [(mark.time_s, mark.error) for mark in marks if mark.is_default]
    axes.plot(
        *zip(*ringed, strict=True), "o", ms=13.0, mfc="none", color=INK, zorder=4, label="default setting"
    )
    for number, family in enumerate(dict.fromkeys(mark.family for mark in marks)):
        shown = [mark for mark in marks if mark.family == family]
        points = [mark.time_s for mark in shown], [mark.error for mark in shown]
        how: dict[str, Any] = {}
        if shown[0] not in placed:
            points, how = ([0.91], [0.09]), {"transform": axes.transAxes}
            words = f"error 0 by definition,\n{1e3 * shown[0].time_s:.3g} ms"
            axes.text(0.87, 0.07, words, transform=axes.transAxes, ha="right", va="center")
            arrow = {"arrowstyle": "->", "color": f"C{number}"}
            axes.annotate("", (1.0, 0.0), (0.91, 0.09), "axes fraction", arrowprops=arrow)
        axes.plot(*points, _MARKERS[number], color=f"C{number}", markersize=7.0, label=family, **how)


def _label_marks(axes: Axes, marks: Sequence[Mark]) -> None:
    """Write labels where they meet no mark, label or line; limits and place of the axes are final."""
    from matplotlib.transforms import Bbox

    families = list(dict.fromkeys(mark.family for mark in marks))
    middles = axes.transData.transform([(mark.time_s, mark.error) for mark in marks])
    front = axes.lines[0].get_path().transformed(axes.transData)
    taken = [Bbox([middle - 7.0, middle + 7.0]) for middle in middles]
    for mark in marks:
        place = (mark.time_s, mark.error)
        text = axes.annotate(mark.label, place, _ASIDE_POINTS[0], textcoords="offset points", ha="center")
        text.set(va="center", in_layout=False, color=f"C{families.index(mark.family)}", weight="bold")
        for text.xyann in _ASIDE_POINTS:
            box = text.get_window_extent()
            if not (box.count_overlaps(taken) or front.intersects_bbox(box, filled=False)):
                break
        taken.append(box.padded(4.0))
