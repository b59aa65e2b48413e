"""Figures of the measurements of a flight: path and points, range and speed, errors against ground truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.beam_colours import beam_colour
from lidar_emu.report.ground_survey import Extent, extent_of, hill_shade, sample_ground
from lidar_emu.report.oblique_view import draw_oblique_view, on_ground
from lidar_emu.report.plot_style import (
    BEAMS_IN_LEGEND,
    INK,
    PATH_COLOUR,
    Drawing,
    draw_figure,
    limited_points,
    name_beams,
    outside_words,
    points,
    truth_limits,
)
from lidar_emu.report.recorded_run import ErrorValues, add_sigma_band, error_values

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lidar_emu.scene.ray_hits import Scene


_GROUND_SAMPLES = 300
_TRUTH = "#8a919c"
_WIDEST_SIGMA = 5.0


def draw_path(measurement: Measurement, scene: Scene | None) -> Drawing:
    """Draw path and measured points over the ground, from above and from an oblique view.

    Both views are fitted to the path and the true hit points. The map marks measured points outside by crosses.
    """
    extent = extent_of(measurement)
    valid = measurement.range_valid
    point_m = measurement.point_site_m[valid]
    outside = int(np.count_nonzero(~extent.contain(point_m)))

    def plot(figure: Figure) -> None:
        above, oblique = figure.subplots(1, 2, width_ratios=(1.0, 1.1))
        _from_above(above, measurement, scene, extent)
        heights = draw_oblique_view(oblique, measurement, scene)
        if heights is not None:
            figure.colorbar(heights, ax=oblique, orientation="horizontal", shrink=0.6, label="height (m)")
        oblique.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=2)

    low_m, high_m = (f(measurement.position_site_m[:, 2]) for f in (np.nanmin, np.nanmax))
    elsewhere = f", {outside} of them far from path and ground and marked by crosses" if outside else ""
    description = (
        f"Path of the vehicle between {low_m:.0f} m and {high_m:.0f} m above the site's origin, and {len(point_m)} "
        f"measured points on the ground{elsewhere}, from above and from an oblique view."
    )
    return draw_figure("path", "Path and footprints", description, 5.2, plot)


def _from_above(axes: Axes, measurement: Measurement, scene: Scene | None, extent: Extent) -> None:
    if scene is not None:
        light = 0.22 + 0.78 * hill_shade(sample_ground(scene, extent, _GROUND_SAMPLES))
        edges = (extent.low_m[0], extent.high_m[0], extent.low_m[1], extent.high_m[1])
        axes.imshow(light, cmap="gray", vmin=0.0, vmax=1.0, extent=edges, origin="lower", zorder=0)
    for beam in range(measurement.beam_count):
        point_m = measurement.point_site_m[measurement.range_valid[:, beam], beam]
        inside = extent.contain(point_m)
        points(axes, *point_m[inside, :2].T, color=beam_colour(beam))
        _mark_outside(axes, *np.clip(point_m[~inside, :2], extent.low_m[:2], extent.high_m[:2]).T)
        axes.plot([], [], "o", color=beam_colour(beam), markersize=4, label=f"beam {beam}")
    east_m, north_m = measurement.position_site_m[:, :2].T
    axes.plot(east_m, north_m, color=INK, linewidth=1.5, path_effects=on_ground(2.8))
    axes.plot(
        east_m[-1], north_m[-1], "o", color="white", markeredgecolor=INK, markersize=5, label="end of path"
    )
    axes.grid(visible=False)
    axes.set(xlabel="east (m)", ylabel="north (m)", aspect="equal")
    axes.set(xlim=(extent.low_m[0], extent.high_m[0]), ylim=(extent.low_m[1], extent.high_m[1]))
    handles, labels = axes.get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))
    if measurement.beam_count > BEAMS_IN_LEGEND:
        named = {label: handle for label, handle in named.items() if not label.startswith("beam ")}
    axes.legend(named.values(), named, loc="lower left", bbox_to_anchor=(-0.1, 1.0), ncols=3,
                columnspacing=1.0, handletextpad=0.2)  # fmt: skip


def _mark_outside(axes: Axes, x: FloatArray, y: FloatArray) -> None:
    if len(x):
        label = "far from the ground"
        axes.plot(x, y, "x", color=PATH_COLOUR, markersize=4.0, clip_on=False, rasterized=True, label=label)


def draw_truth(measurement: Measurement) -> Drawing:
    """Draw range and closing speed with their ground truth."""
    speed_mps, true_mps = measurement.closing_speed_mps, measurement.true_closing_speed_mps
    pairs = (
        ("range (m)", measurement.range_m, measurement.true_range_m, measurement.range_valid),
        ("closing speed (m/s)", speed_mps, true_mps, measurement.speed_valid),
    )
    time_s = np.asarray(measurement.time_ns * 1e-9, dtype=np.float64)
    limits = [truth_limits(measured[valid], true) for _, measured, true, valid in pairs]

    def plot(figure: Figure) -> None:
        for axes, (label, measured, true, valid), own in zip(
            figure.subplots(2, sharex=True), pairs, limits, strict=True
        ):
            for beam in range(measurement.beam_count):
                own_s, shown = time_s[:, beam], valid[:, beam]
                axes.plot(own_s, true[:, beam], color=_TRUTH, linewidth=0.8, zorder=1, rasterized=True)
                found = measured[shown, beam]
                limited_points(axes, beam, measurement.beam_count, own_s[shown], found, own)
                axes.plot([], [], ".", color=beam_colour(beam), label=f"beam {beam}")
            axes.plot([], [], color=_TRUTH, label="ground truth")
            axes.set_ylabel(label)
        name_beams(figure.axes[0], measurement.beam_count)
        figure.axes[-1].set_xlabel("time (s)")

    ranges = _span(measurement.range_m[measurement.range_valid], "m")
    speeds = _span(speed_mps[measurement.speed_valid], "m/s")
    outside = sum(
        int(np.count_nonzero(~own.contain(measured[valid])))
        for (_, measured, _, valid), own in zip(pairs, limits, strict=True)
    )
    description = (
        f"Measured ranges ({ranges}) and closing speeds ({speeds}) of each beam over time, with their ground truth as "
        f"lines.{outside_words(outside)}"
    )
    return draw_figure("truth", "Range and speed against truth", description, 4.6, plot)


def _span(values: FloatArray, unit: str) -> str:
    return f"{values.min():.4g} to {values.max():.4g} {unit}" if values.size else "none valid"


def draw_errors(measurement: Measurement) -> Drawing:
    """Draw errors over time with the band of two stated sigma, and the distribution of error over stated sigma."""
    rows = error_values(measurement)
    time_s = np.asarray(measurement.time_ns * 1e-9, dtype=np.float64)

    def plot(figure: Figure) -> None:
        grid = figure.subplots(2, 2, width_ratios=(3.0, 1.0), sharex="col")
        for (along, spread), row in zip(grid, rows, strict=True):
            for beam in range(measurement.beam_count):
                shown = row.valid[:, beam]
                own = row.error[shown, beam]
                limited_points(along, beam, measurement.beam_count, time_s[shown, beam], own, row.limits())
            add_sigma_band(along, time_s[row.valid], row.sigma[row.valid])
            along.set_ylabel(row.label)
            _add_spread(spread, row.error[row.valid], row.sigma[row.valid])
        grid[1, 0].set_xlabel("time (s)")
        grid[1, 1].set_xlabel("error / stated sigma")
        if grid[0, 0].get_legend_handles_labels()[0]:
            grid[0, 0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0))
            grid[0, 1].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)

    outside = sum(row.outside() for row in rows)
    description = (
        f"Errors of {' and '.join(map(_moments, rows))} over time with the band of two stated standard deviations, and "
        "their distribution in units of the stated standard deviation beside the normal distribution."
        f"{outside_words(outside)}"
    )
    return draw_figure("errors", "Errors and the stated sigma", description, 4.6, plot)


def _moments(row: ErrorValues) -> str:
    error = row.error[row.valid]
    if not np.isfinite(error).any():
        return f"{error.size} {row.quantity}s (unknown)"
    rms, mean = np.sqrt(np.nanmean(error**2)), np.nanmean(error)
    return f"{error.size} {row.quantity}s ({rms:.3g} {row.unit} rms, {mean:+.2g} {row.unit} mean)"


def _add_spread(axes: Axes, error: FloatArray, sigma: FloatArray) -> None:
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = error / sigma
    ratio = ratio[np.isfinite(ratio)]
    axes.set_yticks([])
    if not ratio.size:
        axes.text(0.5, 0.5, "no stated sigma", ha="center", transform=axes.transAxes)
        return
    bins = np.linspace(-_WIDEST_SIGMA, _WIDEST_SIGMA, 61)
    inside = np.abs(ratio) <= _WIDEST_SIGMA
    weight = np.full(int(inside.sum()), 1.0 / (ratio.size * (bins[1] - bins[0])))
    axes.hist(ratio[inside], bins=bins.tolist(), weights=weight, color="C0", alpha=0.7, label="errors")
    axes.plot(
        bins, np.exp(-0.5 * bins**2) / np.sqrt(2.0 * np.pi), color=PATH_COLOUR, linewidth=1.3, label="normal"
    )
    axes.set_xlim(-1.15 * _WIDEST_SIGMA, 1.15 * _WIDEST_SIGMA)
    for beyond, place, side, words in (
        (ratio < -_WIDEST_SIGMA, 0.0, "left", f"below -{_WIDEST_SIGMA:g}"),
        (ratio > _WIDEST_SIGMA, 1.0, "right", f"above {_WIDEST_SIGMA:g}"),
    ):
        if beyond.any():
            text = f"{100.0 * beyond.mean():.2g} %\n{words}"
            axes.text(place, 0.97, text, ha=side, va="top", fontsize=7.5, transform=axes.transAxes)


_LEAST_SPAN = 1.0


def draw_motion(measurement: Measurement, scene: Scene | None) -> Drawing:
    """Draw height, velocity, and roll, pitch and heading of the vehicle from the ground truth."""
    time_s = measurement.time_ns[:, 0] * 1e-9
    position_m, velocity_mps = measurement.position_site_m, measurement.velocity_site_mps
    heights = {"above the origin": position_m[:, 2]}
    if scene is not None:
        heights["above the ground"] = position_m[:, 2] - scene.height_m(*position_m[:, :2].T)
    speeds = {
        "horizontal": np.hypot(velocity_mps[:, 0], velocity_mps[:, 1]),
        "downward": -velocity_mps[:, 2],
    }
    angles_deg = roll_pitch_heading_deg(measurement.site_from_body)
    attitude = dict(zip(("roll", "pitch", "heading"), angles_deg.T, strict=True))
    rows = (("height (m)", heights), ("speed (m/s)", speeds), ("attitude (deg)", attitude))

    def plot(figure: Figure) -> None:
        panels = figure.subplots(len(rows), sharex=True)
        for axes, (label, curves) in zip(panels, rows, strict=True):
            for number, (name, values) in enumerate(curves.items()):
                style = "--" if number == 1 else "-"
                axes.plot(time_s, values, style, linewidth=1.2, label=name)
            _keep_span(axes)
            axes.set_ylabel(label)
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.05))
        panels[-1].set_xlabel("time (s)")

    spans = "; ".join(
        f"{name} {np.nanmin(values):z.1f} to {np.nanmax(values):z.1f}"
        for _, curves in rows
        for name, values in curves.items()
        if np.isfinite(values).any()
    )
    description = (
        "True height (m), speed (m/s) and attitude (deg) of the vehicle; heading clockwise from north, continued "
        f"across 360 deg: {spans}."
    )
    return draw_figure("motion", "Motion of the vehicle", description, 5.0, plot)


def _keep_span(axes: Axes) -> None:
    """Widen the axis to a span of at least 1, so that rounding errors of a constant do not fill it."""
    low, high = axes.get_ylim()
    if high - low < _LEAST_SPAN:
        axes.set_ylim((low + high - _LEAST_SPAN) / 2, (low + high + _LEAST_SPAN) / 2)


def roll_pitch_heading_deg(site_from_body: FloatArray) -> FloatArray:
    """Roll, pitch and heading (n, 3) in degrees of attitudes (n, 4): the aerospace sequence from north-east-down.

    The heading is continued across 360 degrees. Formulas: Diebel, *Representing Attitude* (2006), sequence (1, 2, 3).

    Args:
        site_from_body: unit quaternions w, x, y, z; the site frame is east, north, up.
    """
    w, x, y, z = site_from_body.T
    # Rows of the rotation from body x forward, y right, z down: north is the site's y, east its x, down its -z.
    north_x, east_x, up_x = 2 * (x * y + w * z), 1 - 2 * (y * y + z * z), 2 * (x * z - w * y)
    up_y, up_z = 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    roll = np.arctan2(-up_y, -up_z)
    pitch = np.arcsin(np.clip(up_x, -1.0, 1.0))
    heading = np.arctan2(east_x, north_x)
    known = np.isfinite(heading)
    heading[known] = np.unwrap(heading[known])
    return np.asarray(np.degrees(np.stack([roll, pitch, heading], axis=-1)))
