"""Picture of a flight: an oblique view over the ground, beside range, closing speed and their errors over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.report.beam_colours import BEAM_COLOURS, beam_colour
from lidar_emu.report.oblique_view import (
    BRIDGE_COLOUR,
    FEW_SHOTS,
    LEVEL_SHARE,
    draw_oblique_view,
    largest_angle_deg,
    pattern_changes,
)
from lidar_emu.report.plot_style import (
    FAULT_COLOUR,
    FINE_DPI,
    GRID,
    INK,
    Limits,
    check_plot_path,
    distinct,
    mark_outside,
    styled,
    titled_figure,
    truth_limits,
    write_plot,
)
from lidar_emu.report.recorded_run import ErrorValues, add_sigma_band, error_values

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

    from lidar_emu.scenario.faults import Fault
    from lidar_emu.scene.ray_hits import Scene

_SIZE_INCH = (10.0, 6.9)
_CHANGE: Any = {"color": INK, "linewidth": 0.9, "linestyle": (0, (4, 3))}
"""How a change of the pattern is marked."""
_SEPARATE_BEAMS = 6
"""Largest number of beams whose errors have rows of their own, in which coincident points stay visible."""
_ALTERNATIONS = 24
"""How often the beam changes that is drawn above the others where beams coincide."""


def plot_descent(
    measurement: Measurement,
    scene: Scene | None,
    name: str,
    path: Path,
    faults: Sequence[Fault] = (),
    moving: Mapping[int, str] | None = None,
) -> None:
    """Plot a flight as a PNG of 1600 by 1104 pixels.

    Args:
        measurement: measurement of a flight; beams that fired without a valid range or speed are marked as dropouts.
        scene: ground below the points; None: plot the points alone.
        name: name of the scenario.
        path: file, `.png`, `.svg` or `.pdf`.
        faults: faults of the scenario, to mark.
        moving: names of the site's moving objects, to label, by their number in `true_object`.

    Raises:
        InputError: see `check_plot_path`; or the run is a bench pattern or has no valid range.
        RunError: writing failed.
    """
    check_plot_path(path)
    if np.isnan(measurement.position_site_m).all():
        remedy = "must be a flight: a bench pattern has no ground to draw"
        raise InputError(name, None, Finding("a bench pattern"), remedy)
    if not measurement.range_valid.any():
        found = Finding("a run without a valid range")
        raise InputError(name, None, found, "must be a flight with a valid range")
    write_plot(draw_descent(measurement, scene, name, faults, moving), path)


@styled
def draw_descent(
    measurement: Measurement,
    scene: Scene | None,
    name: str,
    faults: Sequence[Fault] = (),
    moving: Mapping[int, str] | None = None,
) -> Figure:
    """Draw the figure of `plot_descent`."""
    figure = titled_figure(title_of(measurement, name), _SIZE_INCH, 12, FINE_DPI)
    parts: Any = figure.subfigures(1, 2, width_ratios=(0.8, 1.0), wspace=0.02)
    left, right = parts
    axes = left.subplots()
    by_height = draw_oblique_view(axes, measurement, scene, moving)
    if by_height is not None:
        left.colorbar(by_height, ax=axes, orientation="horizontal", shrink=0.7, aspect=40, pad=0.02,
                      label="colour of all points: height of the place measured (m)")  # fmt: skip
    left.legend(*axes.get_legend_handles_labels(), loc="outside lower center")
    _draw_values(right, measurement, faults, by_height, moving or {})
    return figure


def title_of(measurement: Measurement, name: str) -> str:
    """What a flight is, in words: its name, heights, beams and their angles."""
    up_m = measurement.position_site_m[np.isfinite(measurement.position_site_m[:, 2]), 2]
    first_m, last_m = float(up_m[0]), float(up_m[-1])
    what = name.replace("_", " ")
    moves = abs(first_m - last_m) > LEVEL_SHARE * abs(first_m)
    place = f"from {first_m:.0f} m to {last_m:.0f} m" if moves else f"at {first_m:.0f} m"
    beams = measurement.beam_count
    angles = f"{largest_angle_deg(measurement)[0]:.3g}°"
    if changes := pattern_changes(measurement):
        angles += "".join(f", {change.after_deg:.3g}° below {change.up_m:.0f} m" for change in changes)
    elif beams > 1 and np.nanmax(measurement.beam_angle_deg) - np.nanmin(measurement.beam_angle_deg) > 0.0:
        angles = f"up to {angles}"
    return f"{what} {place}: {beams} beam{'s' if beams > 1 else ''} at {angles}"


def _draw_values(
    figure: SubFigure,
    measurement: Measurement,
    faults: Sequence[Fault],
    by_height: Any,
    moving: Mapping[int, str],
) -> None:
    beams = list(range(measurement.beam_count))
    rows = [[beam] for beam in beams] if len(beams) <= _SEPARATE_BEAMS else [beams]
    ratios = (max(1.0, 0.5 * len(rows)), *([1.0] * len(rows)))
    panels = figure.subplots(1 + len(rows), 2, sharex=True, squeeze=False, height_ratios=ratios)
    measured = (
        ("Range (m)", measurement.range_m, measurement.true_range_m),
        ("Closing speed (m/s)", measurement.closing_speed_mps, measurement.true_closing_speed_mps),
    )
    for column, (quantity, (label, values, true)) in enumerate(
        zip(error_values(measurement), measured, strict=True)
    ):
        top, *below = panels[:, column]
        top.set_title(label, loc="left")
        top.plot(measurement.time_s, true, color=GRID, linewidth=0.8, zorder=1)
        limits = truth_limits(values[quantity.valid], true)
        _add_points(top, measurement, values, quantity.valid, limits, by_height)
        limits = quantity.limits()
        below[0].set_title(f"{quantity.label[:1].upper()}{quantity.label[1:]}\n", loc="left")
        for axes, shown in zip(below, rows, strict=True):
            axes.axhline(0, color=GRID, linewidth=0.8, zorder=1)
            part = np.isin(beams, shown)
            _add_points(axes, measurement, quantity.error, quantity.valid & part, limits, by_height)
            _add_losses(axes, measurement, quantity, shown)
            axes.set_title(_mean_and_rms(quantity, shown), loc="right", fontsize=8)
        below[-1].set_xlabel("time (s)")
        for axes in (top, *below):
            axes.margins(x=0.01)
            _add_marks(axes, measurement, faults)
        for change in pattern_changes(measurement):
            at_s = measurement.time_s[change.shot, 0]
            top.annotate(str(change), (at_s, 1.0), (4.0, -2.0), xycoords=("data", "axes fraction"),
                         textcoords="offset points", va="top", fontsize=8)  # fmt: skip
    for axes, shown in zip(panels[1:, 0], rows, strict=True):
        is_one = len(shown) == 1
        named = f"beam {shown[0]}" if is_one else f"{len(beams)} beams"
        axes.set_ylabel(named, color=beam_colour(shown[0]) if is_one else INK)
    _add_keys(figure, measurement, faults, colours=len(beams) > 1 and by_height is None)
    _name_moving(panels[0, 1], measurement, moving)


def _name_moving(axes: Axes, measurement: Measurement, moving: Mapping[int, str]) -> None:
    for number, name in moving.items():
        seen = measurement.speed_valid & (measurement.true_object == number)
        if seen.any():
            place = np.median(measurement.time_s[seen]), np.median(measurement.closing_speed_mps[seen])
            axes.annotate(f"{name},\nmoving", place, (-8.0, 0.0), textcoords="offset points", ha="right",
                          va="center", fontsize=8)  # fmt: skip


def _mean_and_rms(quantity: ErrorValues, beams: list[int]) -> str:
    error = quantity.error[:, beams][quantity.valid[:, beams]]
    error = error[np.isfinite(error)]
    if not error.size:
        return "no errors"
    words = f"mean {error.mean():.2g}, rms {np.sqrt(np.mean(error**2)):.3g} {quantity.unit}"
    return words.replace("-", "−")


def _add_points(
    axes: Axes, measurement: Measurement, values: FloatArray, valid: BoolArray, limits: Limits, by_height: Any
) -> None:
    """Plot valid values of all beams; where beams coincide, each is above the others in turn."""
    axes.set_ylim(limits)
    shot, beam = np.nonzero(valid & limits.contain(values))
    turn = shot * _ALTERNATIONS // len(measurement)
    top_first = np.argsort((beam - turn) % measurement.beam_count, kind="stable")[::-1]
    top_first = top_first[distinct(measurement.time_s[shot, beam][top_first], values[shot, beam][top_first])]
    place = shot[top_first[::-1]], beam[top_first[::-1]]
    how: Any = {"c": [beam_colour(each) for each in place[1]]}
    if by_height is not None:
        how = {"c": measurement.point_site_m[*place, 2], "norm": by_height.norm, "cmap": by_height.cmap}
    axes.scatter(measurement.time_s[place], values[place], s=16.0 if len(measurement) <= FEW_SHOTS else 2.5,
                 linewidths=0, rasterized=True, zorder=2, **how)  # fmt: skip
    for each in range(measurement.beam_count):
        colour = beam_colour(each) if by_height is None else INK
        shown = valid[:, each]
        mark_outside(axes, colour, measurement.time_s[shown, each], values[shown, each], limits)


def _add_losses(axes: Axes, measurement: Measurement, quantity: ErrorValues, beams: list[int]) -> None:
    """Draw the dropouts of some beams at the lower edge, and the stated sigma."""
    valid, time_s = quantity.valid[:, beams], measurement.time_s[:, beams]
    lost_s = np.sort(time_s[measurement.fired[:, beams] & ~valid])
    axes.plot(lost_s, np.full(len(lost_s), 0.05), "|", color=INK, markersize=5, markeredgewidth=0.8,
              transform=axes.get_xaxis_transform(), zorder=3)  # fmt: skip
    add_sigma_band(axes, time_s[valid], quantity.sigma[:, beams][valid])


def _add_marks(axes: Axes, measurement: Measurement, faults: Sequence[Fault]) -> None:
    """Mark changes of the pattern, spans of faults, and bridged gaps."""
    last_s = float(measurement.time_s[-1].max())
    for change in pattern_changes(measurement):
        axes.axvline(measurement.time_s[change.shot, 0], zorder=1, **_CHANGE)
    for fault in faults:
        if fault.at_s is not None:
            axes.axvline(fault.at_s, color=FAULT_COLOUR, linewidth=1.0, zorder=1)
        else:
            until_s = last_s if fault.to_s is None else min(fault.to_s, last_s)
            if fault.from_s < until_s:
                axes.axvspan(fault.from_s, until_s, color=FAULT_COLOUR, alpha=0.14, linewidth=0, zorder=0)
    for start_s, end_s in _bridges(measurement):
        axes.axvspan(start_s, end_s, color=BRIDGE_COLOUR, alpha=0.3, linewidth=0, zorder=0)


def _add_keys(figure: SubFigure, measurement: Measurement, faults: Sequence[Fault], *, colours: bool) -> None:
    """Add the legend below the panels: the marks, and the colours of beams that share a panel."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    def mark(marker: str, label: str, colour: str = GRID) -> Line2D:
        return Line2D([], [], linestyle="", marker=marker, color=colour, markersize=6, label=label)

    beams = measurement.beam_count
    keys: list[Any] = [
        mark("o", _beams_of_colour(colour, beams), beam_colour(colour))
        for colour in range(min(beams, len(BEAM_COLOURS)) if colours and beams > _SEPARATE_BEAMS else 0)
    ]
    if colours:
        keys.append(mark("", "colours alternate where beams coincide"))
    keys += [
        Line2D([], [], color=GRID, linewidth=0.8, label="ground truth"),
        Line2D([], [], color=INK, linewidth=0.9, label="±2σ as the device states it"),
        mark("|", "dropout: fired, no valid value", INK),
        mark("^", "beyond the axis"),
    ]
    if pattern_changes(measurement):
        keys.append(Line2D([], [], label="change of pattern", **_CHANGE))
    if faults:
        kinds = ", ".join(dict.fromkeys(fault.kind.replace("_", " ") for fault in faults))
        keys.append(Patch(color=FAULT_COLOUR, alpha=0.3, linewidth=0, label=f"fault: {kinds}"))
    if measurement.true_in_gap.any():
        keys.append(Patch(color=BRIDGE_COLOUR, alpha=0.3, linewidth=0, label="bridged gap"))
    figure.legend(handles=keys, loc="outside lower center", ncols=2, handletextpad=0.5)


def _beams_of_colour(first: int, beam_count: int) -> str:
    beams = [str(beam) for beam in range(first, beam_count, len(BEAM_COLOURS))]
    return f"beam{'s' if len(beams) > 1 else ''} {', '.join(beams)}"


def _bridges(measurement: Measurement) -> list[tuple[float, float]]:
    inside = np.any(measurement.true_in_gap, axis=1)
    turns = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
    time_s = measurement.time_ns[:, 0] * 1e-9
    return [(time_s[first], time_s[end - 1]) for first, end in turns.reshape(-1, 2)]
