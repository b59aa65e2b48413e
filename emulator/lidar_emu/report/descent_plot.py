"""Plot of a descent: measured points on the ground, and errors against ground truth.

The two upper panels follow figures 3 to 5 of Budge et al.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.errors import Finding, InputError
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.ground_below import Extent, extent_of, sample_ground, slope_to_sun
from lidar_emu.report.png_file import check_plot_path, write_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    from lidar_emu.scene.ray_hits import Scene

_SIZE_INCH = (16.0, 11.0)
_DOTS_PER_INCH = 100
_GROUND_SAMPLES = 80
_BEAMS_IN_LEGEND = 12
_PATH_COLOUR = "#b22222"
_BRIDGE_COLOUR = "#e0a030"


def plot_descent(measurement: Measurement, scene: Scene | None, title: str, path: Path) -> None:
    """Plot a flight as a PNG of 1600 by 1100 pixels.

    Args:
        measurement: measurement of a flight; invalid ranges and speeds are left out of their panels.
        scene: ground below the points; None: plot the points alone.
        title: title of the figure.
        path: file, `.png`.

    Raises:
        InputError: see `check_plot_path`; or the run is a bench pattern or has no valid range.
        RunError: writing failed.
    """
    check_plot_path(path)
    if np.isnan(measurement.position_site_m).all():
        raise InputError(
            title,
            None,
            Finding("a bench pattern"),
            "allowed: a flight; a bench pattern has no ground to draw",
        )
    if not measurement.range_valid.any():
        raise InputError(
            title, None, Finding("a run without a valid range"), "allowed: a flight with a valid range"
        )
    write_png(_draw(measurement, scene, title), path)


def _draw(measurement: Measurement, scene: Scene | None, title: str) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_INCH, dpi=_DOTS_PER_INCH)
    figure.suptitle(title, x=0.5, y=0.975, fontsize=17)
    extent = extent_of(measurement)
    ground_m = None if scene is None else sample_ground(scene, extent, _GROUND_SAMPLES)
    has_speed = measurement.range_valid & measurement.speed_valid
    panels = (
        (0.0, measurement.range_m, measurement.range_valid, "viridis", "range (m)"),
        (0.495, measurement.closing_speed_mps, has_speed, "plasma", "closing speed (m/s)"),
    )
    for left, values, valid, colours, label in panels:
        axes: Any = figure.add_axes((left, 0.385, 0.42, 0.57), projection="3d")
        _set_up(axes, extent)
        if ground_m is not None:
            axes.add_collection3d(_surface(ground_m))
        points = _add_flight(axes, measurement, values, valid, colours)
        bar = figure.colorbar(points, cax=figure.add_axes((left + 0.445, 0.47, 0.011, 0.39)))
        bar.set_label(label)
    _draw_errors(figure, measurement)
    return figure


def _surface(ground_m: FloatArray) -> Any:
    """Build the shaded ground from light grey quadrilaterals whose four corners exist."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

    quads_m = np.stack([ground_m[:-1, :-1], ground_m[:-1, 1:], ground_m[1:, 1:], ground_m[1:, :-1]], axis=2)
    shade = 0.84 + 0.09 * slope_to_sun(ground_m)
    exists = ~np.isnan(quads_m).any(axis=(2, 3))
    grey = np.repeat(shade[exists][:, None], 3, axis=1)
    return Poly3DCollection(quads_m[exists], facecolors=grey, edgecolors=grey, linewidths=0.3, zorder=1)


def _set_up(axes: Any, extent: Extent) -> None:
    # matplotlib sorts whole collections by depth, which hides points behind the ground; the zorder given here is right
    # for every view from above.
    axes.computed_zorder = False
    size_m = extent.high_m - extent.low_m
    axes.set(
        xlim=(extent.low_m[0], extent.high_m[0]),
        ylim=(extent.low_m[1], extent.high_m[1]),
        zlim=(extent.low_m[2], extent.high_m[2]),
        xlabel="east (m)",
        ylabel="north (m)",
        zlabel="up (m)",
    )
    longest_m = size_m[:2].max()
    axes.set_box_aspect(
        (size_m[0], size_m[1], 0.95 * longest_m), zoom=0.95 + 0.08 * size_m[:2].min() / longest_m
    )
    axes.view_init(elev=24, azim=-58)
    shares = (*size_m[:2] / longest_m, 1.0)
    for axis, share in zip((axes.xaxis, axes.yaxis, axes.zaxis), shares, strict=True):
        axis.set_pane_color((1, 1, 1, 0))
        axis.set_major_locator(_ticks(5 if share > 0.7 else 3))
        axis.labelpad = 7


def _ticks(count: int) -> MaxNLocator:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(nbins=count, steps=[1, 2, 2.5, 5, 10])


def _add_flight(
    axes: Any, measurement: Measurement, values: FloatArray, valid: NDArray[np.bool_], colours: str
) -> Any:
    """Draw the path and the measured points; return the coloured points."""
    position_m = measurement.position_site_m
    few = len(measurement) <= 100
    axes.plot(
        *position_m.T,
        color=_PATH_COLOUR,
        linewidth=1.6,
        marker="o" if few else "",
        markersize=3.5,
        label="flight path",
        zorder=3,
    )
    bridged: NDArray[np.bool_] = np.any(measurement.true_in_gap, axis=1)
    if bridged.any():
        gap_m = np.where(bridged[:, None], position_m, np.nan)
        axes.plot(*gap_m.T, color=_BRIDGE_COLOUR, linewidth=1.6, label="bridged gap in the table", zorder=4)
    points = axes.scatter(
        *measurement.point_site_m[valid].T,
        c=values[valid],
        cmap=colours,
        s=26 if few else 5,
        linewidths=0.3 if few else 0,
        edgecolors="black",
        depthshade=False,
        label="measured points",
        zorder=2,
    )
    axes.legend(loc="upper left", bbox_to_anchor=(0.06, 0.97), frameon=False, markerscale=1.0 if few else 2.5)
    return points


def _draw_errors(figure: Figure, measurement: Measurement) -> None:
    range_error_m = measurement.range_m - measurement.true_range_m
    speed_error_mmps = (measurement.closing_speed_mps - measurement.true_closing_speed_mps) * 1e3
    upper = figure.add_axes((0.06, 0.215, 0.86, 0.125))
    lower = figure.add_axes((0.06, 0.06, 0.86, 0.125), sharex=upper)
    _add_errors(upper, measurement, range_error_m, measurement.range_valid)
    _add_errors(lower, measurement, speed_error_mmps, measurement.speed_valid)
    if measurement.true_in_gap.any():
        lower.text(1.005, 0.5, "shaded: bridged\ngaps in the table", transform=lower.transAxes, fontsize=9)
    upper.set_ylabel("range error (m)")
    upper.tick_params(labelbottom=False)
    lower.set_ylabel("speed error (mm/s)")
    lower.set_xlabel("time (s)")
    figure.align_ylabels([upper, lower])
    if measurement.beam_count <= _BEAMS_IN_LEGEND:
        upper.legend(loc="upper left", bbox_to_anchor=(1.005, 1.06), frameon=False, handletextpad=0.1)


def _add_errors(axes: Axes, measurement: Measurement, error: FloatArray, valid: NDArray[np.bool_]) -> None:
    largest = 10.0 if len(measurement) <= 100 else 4.0
    axes.axhline(0, color="0.6", linewidth=0.8, zorder=1)
    for start_s, end_s in _bridges(measurement):
        axes.axvspan(start_s, end_s, color=_BRIDGE_COLOUR, alpha=0.3, linewidth=0, zorder=0)
    for beam in range(measurement.beam_count):
        shown = valid[:, beam]
        # Markers shrink from beam to beam, so that coinciding beams all stay visible.
        size = largest * (1 - 0.6 * beam / measurement.beam_count)
        time_s = measurement.time_s[shown, beam]
        axes.plot(time_s, error[shown, beam], ".", markersize=size, label=f"beam {beam}", zorder=2)
    axes.grid(color="0.92")
    axes.margins(x=0.01)


def _bridges(measurement: Measurement) -> list[tuple[float, float]]:
    """Start and end times of the intervals in which the ground truth is bridged."""
    inside = np.any(measurement.true_in_gap, axis=1)
    turns = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
    time_s = measurement.time_ns[:, 0] * 1e-9
    return [(time_s[first], time_s[end - 1]) for first, end in turns.reshape(-1, 2)]
