"""Plot after figure 2 of Budge et al.: a spectrum with two targets, and the dense point cloud of a scan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.report.paper_echoes import TwoTargets
from lidar_emu.report.png_file import check_plot_path, write_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIZE_INCH = (16.0, 14.5)
_DOTS_PER_INCH = 100
_DECIBELS = (-14.0, 44.0)
_NEAR_BINS = 14
"""Margin beside the outer targets in the close view."""
_SLICE_M = 2.5
"""Along-track length of the slice shown from behind."""
_PAIRS_M = 9.0
"""Across-track width of the close view from above."""
_SPEED_COLOURS = "coolwarm"


def plot_scan(measurement: Measurement, spectrum: TwoTargets, title: str, path: Path) -> None:
    """Plot a scanned flight as a PNG of 1600 by 1450 pixels.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_INCH, dpi=_DOTS_PER_INCH)
    figure.suptitle(title, x=0.5, y=0.985, fontsize=17)
    _add_spectrum(figure, spectrum)
    speed_mmps = 1e3 * measurement.closing_speed_mps
    for left, values, colours, label in (
        (0.0, measurement.range_m, "viridis", "range (m)"),
        (0.5, speed_mmps, _SPEED_COLOURS, "closing speed (mm/s)"),
    ):
        _add_cloud(figure, (left, 0.27, 0.43, 0.44), measurement, values, colours, label)
    _add_slice(figure.add_axes((0.06, 0.05, 0.55, 0.2)), measurement, spectrum.range_bin_m)
    _add_pairs(figure.add_axes((0.68, 0.05, 0.29, 0.2)), measurement, speed_mmps)
    write_png(figure, path)


def _add_spectrum(figure: Figure, spectrum: TwoTargets) -> None:
    bins = np.arange(len(spectrum.power))
    whole = figure.add_axes((0.06, 0.765, 0.44, 0.175))
    close = figure.add_axes((0.56, 0.765, 0.41, 0.175), sharey=whole)
    low, high = spectrum.peak_bin.min() - _NEAR_BINS, spectrum.peak_bin.max() + _NEAR_BINS
    for axes, first, end in ((whole, 1, len(bins) - 1), (close, low, high + 1)):
        decibels = 10.0 * np.log10(np.maximum(spectrum.power[first:end], 1e-9))
        axes.plot(bins[first:end], decibels, color="C0", linewidth=0.7 if axes is whole else 1.2, zorder=2)
        axes.axhline(0.0, color="0.35", linewidth=1.0, label="mean noise", zorder=3)
        axes.axhline(
            10.0 * np.log10(spectrum.threshold), color="C3", linewidth=1.2, label="threshold", zorder=3
        )
        axes.axhline(
            10.0 * np.log10(spectrum.group_power),
            color="C1",
            linestyle="--",
            label="30 % of the peak",
            zorder=3,
        )
        heights = 10.0 * np.log10(spectrum.power[spectrum.peak_bin])
        axes.plot(spectrum.peak_bin, heights, "o", color="C2", label="detected", zorder=4)
        axes.set(ylim=_DECIBELS, xlim=(bins[first], bins[end - 1]), xlabel="bin of the down-chirp's FFT")
        axes.grid(color="0.92")
    for place, range_m in zip(spectrum.peak_bin, spectrum.range_m, strict=True):
        height = 10.0 * np.log10(spectrum.power[place])
        close.annotate(f" {range_m:.2f} m", (place, height), textcoords="offset points", xytext=(6, 2))
    whole.set_ylabel("power over mean noise (dB)")
    whole.legend(frameon=False, ncols=4, loc="lower right", bbox_to_anchor=(1.0, 0.99))


def _add_cloud(
    figure: Figure,
    place: tuple[float, float, float, float],
    measurement: Measurement,
    values: FloatArray,
    colours: str,
    label: str,
) -> None:
    valid = measurement.range_valid & measurement.speed_valid
    points_m = measurement.point_site_m[valid]
    axes: Any = figure.add_axes(place, projection="3d")
    axes.set_box_aspect(np.ptp(points_m, axis=0), zoom=1.05)
    axes.view_init(elev=34, azim=-62)
    drawn = axes.scatter(*points_m.T, c=values[valid], cmap=colours, s=5, linewidths=0, depthshade=False)
    axes.set(xlabel="east (m)", ylabel="north (m)", zlabel="up (m)")
    axes.zaxis.set_major_locator(_few_ticks())
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((1, 1, 1, 0))
    left, bottom, width, height = place
    bar = figure.colorbar(
        drawn, cax=figure.add_axes((left + width + 0.015, bottom + 0.1, 0.01, height - 0.2))
    )
    bar.set_label(label)


def _few_ticks() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(nbins=4, steps=[1, 2, 5, 10])


def _add_slice(axes: Axes, measurement: Measurement, range_bin_m: float) -> None:
    """Draw the points of a few scan lines from behind, and arcs at whole range bins below the sensor."""
    shown = slice_of(measurement, _SLICE_M)
    points_m = measurement.point_site_m[shown]
    axes.plot(points_m[:, 0], points_m[:, 2], ".", color="C0", markersize=5, zorder=3)
    sensor_up_m = float(measurement.position_site_m[len(measurement) // 2, 2])
    east_m = np.linspace(points_m[:, 0].min(), points_m[:, 0].max(), 200)
    low, high = (sensor_up_m - limit_m for limit_m in (points_m[:, 2].max(), points_m[:, 2].min()))
    for whole in np.arange(np.floor(low / range_bin_m), np.ceil(1.01 * high / range_bin_m)):
        arc_m = sensor_up_m - np.sqrt((whole * range_bin_m) ** 2 - east_m**2)
        axes.plot(east_m, arc_m, color="0.85", linewidth=0.6, zorder=1)
    margin_m = 2 * range_bin_m
    axes.set(xlabel="east (m)", ylabel="up (m)", xlim=(east_m[0] - 1, east_m[-1] + 1))
    axes.set_ylim(points_m[:, 2].min() - margin_m, points_m[:, 2].max() + margin_m)
    axes.set_title(
        f"{_SLICE_M:g} m of the flight from behind; grey: whole range bins, {range_bin_m:.4f} m apart",
        fontsize=10,
    )


def _add_pairs(axes: Axes, measurement: Measurement, speed_mmps: FloatArray) -> None:
    """Draw the points of a few scan lines from above: the beams point slightly forward and aft."""
    seen = measurement.range_valid & measurement.speed_valid
    points_m = measurement.point_site_m
    axes.scatter(
        points_m[seen][:, 0],
        points_m[seen][:, 1],
        c=speed_mmps[seen],
        cmap=_SPEED_COLOURS,
        s=28,
        linewidths=0,
    )
    middle_m = measurement.position_site_m[len(measurement) // 2, :2]
    axes.set_xlim(middle_m[0] - _PAIRS_M / 2, middle_m[0] + _PAIRS_M / 2)
    axes.set_ylim(middle_m[1] - _SLICE_M, middle_m[1] + _SLICE_M)
    axes.set(xlabel="east (m)", ylabel="north (m)")
    axes.set_title("close view from above, by closing speed", fontsize=10)


def slice_of(measurement: Measurement, length_m: float) -> BoolArray:
    """(shots, beams) Whether a point is valid and within half a length of the middle of the flight, along track."""
    middle_m = measurement.position_site_m[len(measurement) // 2, 1]
    near = np.abs(measurement.point_site_m[..., 1] - middle_m) <= length_m / 2
    return np.asarray(near & measurement.range_valid)
