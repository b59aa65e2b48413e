"""Plot of a detection forecast: signal-to-noise ratio and probabilities over altitude."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.plan.detection_forecast import DetectionForecast
from lidar_emu.report.png_file import check_plot_path, write_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIZE_INCH = (16.0, 11.0)
_DOTS_PER_INCH = 100
_ANGLES_IN_LEGEND = 12
_LEAST_PROBABILITY = 1e-6

_Curve = tuple[str, Literal["-", "--", ":"], FloatArray]
"""Label, line style and probabilities (angles, altitudes)."""


def plot_detection(forecast: DetectionForecast, title: str, path: Path) -> None:
    """Plot a forecast as a PNG of 1600 by 1100 pixels: a colour per beam angle, a line style per fading model.

    Raises:
        InputError: see `check_plot_path`; or the ground is beyond the maximum range at every altitude.
        RunError: writing failed.
    """
    check_plot_path(path)
    if not np.isfinite(forecast.snr_db).any():
        raise InputError(
            title,
            None,
            Finding("no beam with an echo"),
            "choose altitudes from which the ground is within detection.maximum_range_m",
        )
    write_png(_draw(forecast, title), path)


def _draw(forecast: DetectionForecast, title: str) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_INCH, dpi=_DOTS_PER_INCH)
    figure.suptitle(title, x=0.5, y=0.975, fontsize=17)
    snr = figure.add_axes((0.06, 0.69, 0.8, 0.24))
    measured = figure.add_axes((0.06, 0.38, 0.8, 0.27), sharex=snr)
    false_lock = figure.add_axes((0.06, 0.07, 0.8, 0.27), sharex=snr)
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
    for axes in (snr, measured):
        axes.tick_params(labelbottom=False)
    figure.align_ylabels([snr, measured, false_lock])
    return figure


def _add_snr(axes: Axes, forecast: DetectionForecast) -> None:
    for i, angle_deg in enumerate(forecast.angle_deg):
        axes.plot(
            forecast.altitude_m, forecast.snr_db[i], color=f"C{i % 10}", label=f"{angle_deg:g}° off nadir"
        )
    threshold_db = 10.0 * np.log10(forecast.minus_log_pfa)
    axes.axhline(threshold_db, color="0.6", linewidth=0.8, zorder=1, label="threshold of one look")
    axes.set_ylabel("bin SNR (dB)")
    axes.grid(color="0.92")
    if len(forecast.angle_deg) <= _ANGLES_IN_LEGEND:
        axes.legend(loc="upper left", bbox_to_anchor=(1.005, 1.03), frameon=False)


def _add_curves(axes: Axes, forecast: DetectionForecast, curves: tuple[_Curve, ...]) -> None:
    from matplotlib.lines import Line2D

    for _, style, probability in curves:
        for i in range(len(forecast.angle_deg)):
            axes.plot(forecast.altitude_m, probability[i], style, color=f"C{i % 10}")
    axes.grid(color="0.92")
    handles = [Line2D([], [], color="0.3", linestyle=style, label=label) for label, style, _ in curves]
    axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.005, 1.03), frameon=False)
