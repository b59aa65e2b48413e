"""Plot of the hazards detected in the points of a flight: heights, detection, slopes, and boulders with a point."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.hazards import BOULDERS_M, CIRCLES_M, SIGMAS, Band, Cloud
from lidar_emu.report.png_file import check_plot_path, write_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIZE_INCH = (16.0, 11.0)
_DOTS_PER_INCH = 100
_LEAST_HEIGHT_M = 1e-3
"""Lower end of the axis of heights; smaller heights are drawn there."""


def plot_hazards(cloud: Cloud, bands: Sequence[Band], shares: FloatArray, title: str, path: Path) -> None:
    """Plot a PNG of 1600 by 1100 pixels.

    Args:
        cloud: points of a flight.
        bands: statistics of the points by altitude.
        shares: (circles, boulders) shares of boulders with a point, as of `touched_shares`.
        title: title of the figure.
        path: file, `.png`.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    write_png(draw_hazards(cloud, bands, shares, title), path)


def draw_hazards(cloud: Cloud, bands: Sequence[Band], shares: FloatArray, title: str) -> Figure:
    """Draw the figure of `plot_hazards`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_INCH, dpi=_DOTS_PER_INCH, layout="constrained")
    figure.suptitle(title, fontsize=17)
    (heights, detection), (slopes, boulders) = figure.subplots(2, 2)
    _draw_heights(heights, cloud, bands)
    _draw_detection(detection, bands)
    _draw_slopes(slopes, cloud, bands)
    _draw_boulders(boulders, shares)
    for axes in (heights, detection, slopes, boulders):
        axes.grid(alpha=0.3)
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), frameon=False)
    return figure


def _draw_heights(axes: Axes, cloud: Cloud, bands: Sequence[Band]) -> None:
    height_m = np.maximum(np.abs(cloud.true_off_m), _LEAST_HEIGHT_M)
    for chosen, colour, label in (
        (~cloud.stands_out, "0.6", "not detected"),
        (cloud.stands_out, "C3", "detected"),
    ):
        axes.plot(
            cloud.altitude_m[chosen], height_m[chosen], ".", color=colour, markersize=3.5,
            label=f"{label} ({chosen.sum()})",
        )  # fmt: skip
    middle_m = [np.sqrt(band.low_m * band.high_m) for band in bands]
    axes.plot(
        middle_m, [band.detected_from_m for band in bands], "k.-", linewidth=1.0,
        label="nine in ten\ndetected above",
    )  # fmt: skip
    axes.set(
        xscale="log", yscale="log", xlabel="altitude (m)", ylabel="true height off the surroundings (m)",
        title=f"points; detected: {SIGMAS:g} sigma off the plane through their neighbours",
    )  # fmt: skip


def _draw_detection(axes: Axes, bands: Sequence[Band]) -> None:
    rows = (
        (
            "detected, of the points\nabove the line on the left",
            "C3",
            [(b, b.detected, b.higher) for b in bands],
        ),
        ("false alarms, of the\nlevel points", "C0", [(b, b.alarms, b.level) for b in bands]),
    )
    for label, colour, values in rows:
        known = [(band, 100.0 * share, count) for band, share, count in values if share is not None]
        axes.plot(
            [np.sqrt(band.low_m * band.high_m) for band, _, _ in known], [share for _, share, _ in known],
            "o-", color=colour, label=label,
        )  # fmt: skip
        for band, share, count in known:
            axes.annotate(
                str(count), (np.sqrt(band.low_m * band.high_m), share), (0, 6), color=colour, fontsize=8,
                textcoords="offset points", ha="center",
            )  # fmt: skip
    axes.set(
        xscale="log", ylim=(-4, 108), xlabel="altitude (m)", ylabel="share of the points (%)",
        title="detection by altitude, with the number of points",
    )  # fmt: skip


def _draw_slopes(axes: Axes, cloud: Cloud, bands: Sequence[Band]) -> None:
    error_deg = np.abs(cloud.slope_deg - cloud.true_slope_deg)
    axes.plot(cloud.slope_altitude_m, error_deg, ".", color="0.6", markersize=3.5, label="error of a shot")
    middle_m = [np.sqrt(band.low_m * band.high_m) for band in bands]
    for label, style, values in (
        ("rms error", "C3.-", [band.slope_error_deg for band in bands]),
        ("rms expected\nfrom stated sigma", "k.--", [band.slope_sigma_deg for band in bands]),
    ):
        axes.plot(middle_m, values, style, linewidth=1.2, label=label)
    axes.set(
        xscale="log", yscale="log", xlabel="altitude (m)", ylabel="error of the slope (deg)",
        title="slope of the plane through the beams of a shot",
    )  # fmt: skip


def _draw_boulders(axes: Axes, shares: FloatArray) -> None:
    for diameter_m, share in zip(BOULDERS_M, shares.T, strict=True):
        axes.plot(CIRCLES_M, 100.0 * share, "o-", label=f"{diameter_m:g} m across")
    axes.set(
        xscale="log", ylim=(0, None), xlabel="radius of the circle about the origin (m)",
        ylabel="boulders with a point on them (%)", title="boulders within a circle",
    )  # fmt: skip
