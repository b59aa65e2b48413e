"""Plots of statistics: campaigns, detection forecasts, and error against run time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.plan.detection_forecast import DetectionForecast
from lidar_emu.report.beam_colours import BEAM_COLOURS, beam_colour
from lidar_emu.report.plot_style import GRID, INK, check_plot_path, styled, titled_figure, write_plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_CAMPAIGN_INCH = (12.8, 9.6)


@dataclass(frozen=True)
class CampaignColumn:
    """Data of one column of panels. The last axis of each array of estimates is (value, low, high)."""

    label: str
    logarithmic: bool
    edge: FloatArray
    """(bands, 2) Lower and upper edge."""
    dropout: FloatArray
    """(bands, 3)"""
    quantiles: dict[str, FloatArray]
    """Quantiles (levels, bands, 3) by the label of the error."""


@styled
def plot_campaign(columns: Sequence[CampaignColumn], levels: Sequence[str], title: str, path: Path) -> None:
    """Plot a PNG of 1600 by 1200 pixels: a column per axis; dropout rate above, quantiles of errors below.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    figure = titled_figure(title, _CAMPAIGN_INCH, 14)
    rows = 1 + max(len(column.quantiles) for column in columns)
    panels = figure.subplots(rows, len(columns), sharex="col", squeeze=False)
    for j, column in enumerate(columns):
        _draw_dropout(panels[0, j], column)
        for axes, (label, quantiles) in zip(panels[1:, j], column.quantiles.items(), strict=True):
            _draw_errors(axes, column, label, quantiles, levels)
        panels[-1, j].set_xlabel(column.label)
    figure.legend(*panels[-1, 0].get_legend_handles_labels(), loc="outside lower center", ncols=len(levels))
    write_plot(figure, path)


def _draw_dropout(axes: Axes, column: CampaignColumn) -> None:
    _draw_bands(axes, column, 100.0 * column.dropout, "C3", None)
    largest = float(np.nanmax(column.dropout[:, 0], initial=0.0))
    axes.set(ylabel="dropouts (%)", ylim=(0.0, 160.0 * largest or 1.0))


def _draw_errors(
    axes: Axes, column: CampaignColumn, label: str, quantiles: FloatArray, levels: Sequence[str]
) -> None:
    for i, level in enumerate(levels):
        _draw_bands(axes, column, quantiles[i], f"C{i}", level)
    # Bands of mostly false locks, with errors of kilometres, must not set the scale.
    known = np.abs(quantiles[:, :, 0][np.isfinite(quantiles[:, :, 0])])
    largest = float(np.percentile(known, 90)) if known.size else 0.0
    axes.set(ylabel=label, ylim=(-1.8 * largest, 1.8 * largest) if largest > 0 else None)


def _draw_bands(
    axes: Axes, column: CampaignColumn, estimate: FloatArray, colour: str, label: str | None
) -> None:
    low, high = column.edge.T
    middle = np.sqrt(low * high) if column.logarithmic else (low + high) / 2
    value, least, most = estimate.T
    axes.fill_between(middle, least, most, color=colour, alpha=0.25, linewidth=0)
    axes.plot(middle, value, color=colour, marker=".", linewidth=1.2, label=label)
    if column.logarithmic:
        axes.set_xscale("log")
    axes.grid(alpha=0.3)


_SENSITIVITY_INCH = (12.8, 1.9)
"""Width of the figure, and height of a row."""


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
    """Plot bars with intervals: a row per output that has indices; total ones are light, first ones lie on them.

    Raises:
        InputError: see `check_plot_path`; or no output has indices.
        RunError: writing failed.
    """
    from matplotlib.patches import Patch

    check_plot_path(path)
    panels = [panel for panel in panels if panel.bands]
    if not panels:
        raise InputError(title, None, Finding("no output that varies"), "draw keys that change the runs")
    width_inch, row_inch = _SENSITIVITY_INCH
    figure = titled_figure(title, (width_inch, row_inch * len(panels) + 1.2), 14)
    rows = figure.subplots(len(panels), squeeze=False)[:, 0]
    for axes, panel, below in zip(rows, panels, [*panels[1:], None], strict=True):
        _draw_indices(axes, panel, factors)
        axes.tick_params(labelbottom=below is None or below.bands != panel.bands)
    handles, labels = rows[0].get_legend_handles_labels()
    for name, opacity in _OPACITIES.items():
        handles.append(Patch(color=GRID, alpha=opacity, linewidth=0))
        labels.append(f"{name} index")
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    write_plot(figure, path)


_OPACITIES = {"total": 0.35, "first": 1.0}


def _draw_indices(axes: Axes, panel: SensitivityPanel, factors: Sequence[str]) -> None:
    """Draw a group of bars per band, a bar per factor; those that repeat a colour are hatched."""
    width, place = 0.84 / len(factors), np.arange(len(panel.bands))
    for k, factor in enumerate(factors):
        middle = place + (k - (len(factors) - 1) / 2) * width
        hatch = "//" if k >= len(BEAM_COLOURS) else None
        for (name, opacity), indices, aside in zip(
            _OPACITIES.items(), (panel.total, panel.first), (0.18, -0.18), strict=True
        ):
            value, low, high = indices[:, k].T
            label = factor if name == "first" else None
            axes.bar(
                middle, value, 0.9 * width, color=beam_colour(k), alpha=opacity, hatch=hatch, label=label
            )
            bounds = [value - low, high - value]
            axes.errorbar(middle + aside * width, value, bounds, fmt="none", ecolor=INK, elinewidth=0.7)
    axes.set_xticks(place, [band.replace(": ", "\n") for band in panel.bands])
    axes.set_title(panel.label, loc="left")
    axes.set(ylim=(-0.1, 1.3), xlim=(-0.5, len(place) - 0.5))
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


_WORK_PRECISION_INCH = (8.8, 4.4)
_MARKERS = "osD^vP"


class Mark(NamedTuple):
    """One setting with its error and computing time."""

    family: str
    """Settings of a family share colour and marker."""
    label: str
    """Label of the point if it is on the Pareto front."""
    time_s: float
    error: float
    on_front: bool


@styled
def plot_work_precision(
    panels: Sequence[tuple[str, Sequence[Mark], float | None]], title: str, path: Path
) -> None:
    """Plot panels with one legend, as they share families, side by side as a PNG of 1100 by 550 pixels.

    Args:
        panels: for each panel, the name and unit of the error, the settings, and the statistical resolution of the
            comparison. The reference has an error of 0 and is plotted on the lower edge.
        title: title of the figure.
        path: file, `.png`, `.svg` or `.pdf`.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    figure = titled_figure(title, _WORK_PRECISION_INCH, 12)
    for axes, (name, marks, floor) in zip(
        figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True
    ):
        _add_panel(axes, marks, floor)
        axes.set(xscale="log", yscale="log", xlabel="time per beam measurement (s)", ylabel=name)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=6, frameon=False)
    write_plot(figure, path)


def _add_panel(axes: Axes, marks: Sequence[Mark], floor: float | None) -> None:
    lowest = 0.3 * min((mark.error for mark in marks if mark.error > 0.0), default=1.0)
    front = sorted((mark.time_s, max(mark.error, lowest)) for mark in marks if mark.on_front)
    axes.plot(*zip(*front, strict=True), color=GRID, linewidth=1.2, zorder=1, label="Pareto front")
    if floor is not None and floor > 0.0:
        axes.axhline(floor, color=GRID, linestyle=":", zorder=1, label="statistical resolution")
    for number, family in enumerate(dict.fromkeys(mark.family for mark in marks)):
        label: str | None = family
        for size, edge, is_front in ((7.0, "none", False), (11.0, INK, True)):
            shown = [mark for mark in marks if (mark.family, mark.on_front) == (family, is_front)]
            if not shown:
                continue
            axes.plot(
                [mark.time_s for mark in shown],
                [max(mark.error, lowest) for mark in shown],
                _MARKERS[number % len(_MARKERS)],
                color=f"C{number % 10}",
                markersize=size,
                markeredgecolor=edge,
                label=label,
                zorder=2,
            )
            label = None
    for k, mark in enumerate(mark for mark in marks if mark.on_front):
        place = (mark.time_s, max(mark.error, lowest))
        aside = (8, 5) if k % 2 else (-6, -16)  # labels of neighbouring settings would overlap
        axes.annotate(mark.label, place, textcoords="offset points", xytext=aside)
