"""Plot of a descent: path and measured points over the ground, and the errors of each beam against ground truth.

The view of the ground follows figures 3 to 5 of Budge et al.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.report.beam_colours import beam_colour
from lidar_emu.report.ground_survey import Extent, extent_of, sample_ground, slope_to_sun
from lidar_emu.report.plot_style import GRID, Limits, check_plot_path, mark_outside, titled_figure, write_plot
from lidar_emu.report.recorded_run import ErrorValues, add_sigma_band, error_values

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lidar_emu.scene.ray_hits import Scene

_SIZE_INCH = (16.0, 9.5)
_GROUND_SAMPLES = 80
_SEPARATE_BEAMS = 6
"""Largest number of beams with rows of their own, in which coincident points stay visible."""
_FEW_SHOTS = 100
_PATH_COLOUR = "#b22222"
_BRIDGE_COLOUR = "#e0a030"
_DROPOUT_COLOUR = "black"


def plot_descent(measurement: Measurement, scene: Scene | None, title: str, path: Path) -> None:
    """Plot a flight as a PNG of 1600 by 950 pixels.

    Args:
        measurement: measurement of a flight; beams that fired without a valid range or speed are marked as dropouts.
        scene: ground below the points; None: plot the points alone.
        title: title of the figure.
        path: file, `.png`, `.svg` or `.pdf`.

    Raises:
        InputError: see `check_plot_path`; or the run is a bench pattern or has no valid range.
        RunError: writing failed.
    """
    check_plot_path(path)
    if np.isnan(measurement.position_site_m).all():
        remedy = "must be a flight: a bench pattern has no ground to draw"
        raise InputError(title, None, Finding("a bench pattern"), remedy)
    if not measurement.range_valid.any():
        found = Finding("a run without a valid range")
        raise InputError(title, None, found, "must be a flight with a valid range")
    write_plot(draw_descent(measurement, scene, title), path)


def draw_descent(measurement: Measurement, scene: Scene | None, title: str) -> Figure:
    """Draw the figure of `plot_descent`."""
    figure = titled_figure(title, _SIZE_INCH, 17, title_at=0.975)
    extent = extent_of(measurement)
    axes: Any = figure.add_axes((-0.015, 0.09, 0.415, 0.82), projection="3d")
    _set_up(axes, extent)
    if scene is not None:
        axes.add_collection3d(_surface(sample_ground(scene, extent, _GROUND_SAMPLES)))
    points = _add_flight(axes, measurement, extent)
    bar = figure.colorbar(points, cax=figure.add_axes((0.06, 0.07, 0.28, 0.014)), orientation="horizontal")
    bar.set_label("range (m)")
    _draw_errors(figure, measurement)
    return figure


def _surface(ground_m: FloatArray) -> Any:
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

    quads_m = np.stack([ground_m[:-1, :-1], ground_m[:-1, 1:], ground_m[1:, 1:], ground_m[1:, :-1]], axis=2)
    shade = 0.84 + 0.09 * slope_to_sun(ground_m)
    exists = ~np.isnan(quads_m).any(axis=(2, 3))
    grey = np.repeat(shade[exists][:, None], 3, axis=1)
    return Poly3DCollection(quads_m[exists], facecolors=grey, edgecolors=grey, linewidths=0.3, zorder=1)


def _set_up(axes: Any, extent: Extent) -> None:
    from matplotlib.ticker import MaxNLocator

    # matplotlib sorts whole collections by depth, which hides points behind the ground; the zorder given here is right
    # for every view from above.
    axes.computed_zorder = False
    size_m = extent.high_m - extent.low_m
    x_m, y_m, z_m = zip(extent.low_m, extent.high_m, strict=True)
    axes.set(xlim=x_m, ylim=y_m, zlim=z_m, xlabel="east (m)", ylabel="north (m)", zlabel="up (m)")
    longest_m = size_m[:2].max()
    axes.set_box_aspect(
        (size_m[0], size_m[1], 0.95 * longest_m), zoom=0.95 + 0.08 * size_m[:2].min() / longest_m
    )
    axes.view_init(elev=24, azim=-58)
    shares = (*size_m[:2] / longest_m, 1.0)
    for axis, share in zip((axes.xaxis, axes.yaxis, axes.zaxis), shares, strict=True):
        axis.set_pane_color((1, 1, 1, 0))
        axis.set_major_locator(MaxNLocator(nbins=5 if share > 0.7 else 3, steps=[1, 2, 2.5, 5, 10]))
        axis.labelpad = 7


def _add_flight(axes: Any, measurement: Measurement, extent: Extent) -> Any:
    position_m = measurement.position_site_m
    few = len(measurement) <= _FEW_SHOTS
    axes.plot(
        *position_m.T,
        color=_PATH_COLOUR,
        linewidth=1.6,
        marker="o" if few else "",
        markersize=3.5,
        label="flight path",
        zorder=3,
    )
    bridged: BoolArray = np.any(measurement.true_in_gap, axis=1)
    if bridged.any():
        gap_m = np.where(bridged[:, None], position_m, np.nan)
        axes.plot(*gap_m.T, color=_BRIDGE_COLOUR, linewidth=1.6, label="bridged gap in the table", zorder=4)
    lost = measurement.fired & ~measurement.range_valid & np.isfinite(measurement.true_point_site_m[..., 2])
    if lost.any():
        axes.plot(
            *measurement.true_point_site_m[lost].T,
            "x",
            color=_DROPOUT_COLOUR,
            markersize=4.5 if few else 3.0,
            markeredgewidth=0.8,
            label=f"dropouts, at the true hit point ({lost.sum()})",
            zorder=4,
        )
    point_m, range_m = (a[measurement.range_valid] for a in (measurement.point_site_m, measurement.range_m))
    near = np.all((point_m >= extent.low_m) & (point_m <= extent.high_m), axis=1)
    far = f", {np.count_nonzero(~near)} more outside" if not near.all() else ""
    points = axes.scatter(
        *point_m[near].T,
        c=range_m[near],
        cmap="viridis",
        s=26 if few else 5,
        linewidths=0.3 if few else 0,
        edgecolors="black",
        depthshade=False,
        label=f"measured points{far}",
        zorder=2,
    )
    axes.legend(loc="upper left", bbox_to_anchor=(0.06, 1.04), frameon=False, markerscale=1.0 if few else 2.5)
    return points


def _draw_errors(figure: Figure, measurement: Measurement) -> None:
    beams = list(range(measurement.beam_count))
    rows = [[beam] for beam in beams] if len(beams) <= _SEPARATE_BEAMS else [beams]
    grid = figure.add_gridspec(
        len(rows), 2, left=0.475, right=0.985, bottom=0.1, top=0.86, wspace=0.14, hspace=0.14
    )
    panels = grid.subplots(sharex=True, sharey="col", squeeze=False)
    for column, quantity in enumerate(error_values(measurement)):
        limits = quantity.limits()
        for axes, shown in zip(panels[:, column], rows, strict=True):
            _add_errors(axes, measurement, quantity, limits, shown)
        panels[-1, column].set_xlabel("time (s)")
        panels[0, column].set_title(quantity.label, fontsize=11, loc="left")
    for axes, shown in zip(panels[:, 0], rows, strict=True):
        axes.set_ylabel(f"beam {shown[0]}" if len(shown) == 1 else f"beams 0 to {shown[-1]}")
    _add_key(figure, measurement)


def _add_errors(
    axes: Axes, measurement: Measurement, quantity: ErrorValues, limits: Limits, beams: list[int]
) -> None:
    size = 8.0 if len(measurement) <= _FEW_SHOTS else 3.5
    axes.axhline(0, color="0.6", linewidth=0.8, zorder=1)
    for start_s, end_s in _bridges(measurement):
        axes.axvspan(start_s, end_s, color=_BRIDGE_COLOUR, alpha=0.3, linewidth=0, zorder=0)
    axes.set_ylim(limits)
    for beam in beams:
        time_s, colour = measurement.time_s[:, beam], beam_colour(beam)
        shown = quantity.valid[:, beam] & limits.contain(quantity.error[:, beam])
        axes.plot(time_s[shown], quantity.error[shown, beam], ".", color=colour, markersize=size,
                  markeredgewidth=0, zorder=2)  # fmt: skip
        valid = quantity.valid[:, beam]
        mark_outside(axes, colour, time_s[valid], quantity.error[valid, beam], limits)
        lost_s = time_s[measurement.fired[:, beam] & ~valid]
        axes.plot(lost_s, np.full(len(lost_s), 0.04), "|", color=_DROPOUT_COLOUR, markersize=6,
                  markeredgewidth=0.8, transform=axes.get_xaxis_transform(), zorder=3)  # fmt: skip
    if len(beams) == 1:
        valid = quantity.valid[:, beams[0]]
        add_sigma_band(axes, measurement.time_s[valid, beams[0]], quantity.sigma[valid, beams[0]])
    axes.grid(color="0.92")
    axes.margins(x=0.01)


def _add_key(figure: Figure, measurement: Measurement) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    def mark(marker: str, label: str, colour: str = "C0") -> Line2D:
        return Line2D([], [], linestyle="", marker=marker, color=colour, markersize=6, label=label)

    handles: list[Any] = [mark(".", "error of a beam"), mark("^", "error outside the axis")]
    if measurement.beam_count <= _SEPARATE_BEAMS:
        handles.append(Patch(color=GRID, alpha=0.3, linewidth=0, label="2 stated sigma"))
    handles.append(mark("|", "dropout: fired, not valid", _DROPOUT_COLOUR))
    if measurement.true_in_gap.any():
        handles.append(Patch(color=_BRIDGE_COLOUR, alpha=0.3, label="bridged gap in the table"))
    figure.legend(handles=handles, loc="lower right", bbox_to_anchor=(0.985, 0.885), ncols=len(handles),
                  frameon=False, handletextpad=0.3, columnspacing=1.4)  # fmt: skip


def _bridges(measurement: Measurement) -> list[tuple[float, float]]:
    inside = np.any(measurement.true_in_gap, axis=1)
    turns = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
    time_s = measurement.time_ns[:, 0] * 1e-9
    return [(time_s[first], time_s[end - 1]) for first, end in turns.reshape(-1, 2)]
