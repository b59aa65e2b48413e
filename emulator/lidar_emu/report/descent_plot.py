"""Picture of a flight: an oblique view over the ground, beside range, closing speed and their errors over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.beam_colours import BEAM_COLOURS, beam_colour
from lidar_emu.report.oblique_view import (
    BRIDGE_COLOUR,
    FEW_SHOTS,
    MOST_COLOURED_BEAMS,
    draw_oblique_view,
    largest_angle_deg,
    pattern_changes,
)
from lidar_emu.report.plot_style import (
    FAULT_COLOUR,
    GRID,
    INK,
    Limits,
    check_plot_path,
    limited_points,
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

_SIZE_INCH = (12.8, 7.2)
_CHANGE: Any = {"color": INK, "linewidth": 0.9, "linestyle": (0, (4, 3))}
"""How a change of the pattern is marked."""
_SEPARATE_BEAMS = 6
"""Largest number of beams whose errors have rows of their own, in which coincident points stay visible."""
_LEVEL_SHARE = 0.05
"""Share of its height by which a flight may climb or sink, to be stated with one height."""


def plot_descent(
    measurement: Measurement, scene: Scene | None, name: str, path: Path, faults: Sequence[Fault] = ()
) -> None:
    """Plot a flight as a PNG of 1600 by 900 pixels.

    Args:
        measurement: measurement of a flight; beams that fired without a valid range or speed are marked as dropouts.
        scene: ground below the points; None: plot the points alone.
        name: name of the scenario.
        path: file, `.png`, `.svg` or `.pdf`.
        faults: faults of the scenario, to mark.

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
    write_plot(draw_descent(measurement, scene, name, faults), path)


@styled
def draw_descent(
    measurement: Measurement, scene: Scene | None, name: str, faults: Sequence[Fault] = ()
) -> Figure:
    """Draw the figure of `plot_descent`."""
    figure = titled_figure(title_of(measurement, name), _SIZE_INCH, 14)
    parts: Any = figure.subfigures(1, 2, width_ratios=(0.86, 1.0), wspace=0.02)
    left, right = parts
    axes = left.subplots()
    by_height = draw_oblique_view(axes, measurement, scene)
    if by_height is not None:
        left.colorbar(by_height, ax=axes, orientation="horizontal", shrink=0.5, aspect=40, pad=0.02,
                      label="height of the measured points (m)")  # fmt: skip
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.01), ncols=2)
    _draw_values(right, measurement, faults)
    return figure


def title_of(measurement: Measurement, name: str) -> str:
    """What a flight is, in title case: its name, heights, beams and their angles."""
    up_m = measurement.position_site_m[np.isfinite(measurement.position_site_m[:, 2]), 2]
    first_m, last_m = float(up_m[0]), float(up_m[-1])
    what = name.replace("_", " ").title()
    moves = abs(first_m - last_m) > _LEVEL_SHARE * abs(first_m)
    place = f"from {first_m:.0f} m to {last_m:.0f} m" if moves else f"at {first_m:.0f} m"
    beams = measurement.beam_count
    angles = f"{largest_angle_deg(measurement)[0]:.3g}°"
    if changes := pattern_changes(measurement):
        angles += "".join(f", {change.after_deg:.3g}° below {change.up_m:.0f} m" for change in changes)
    elif beams > 1 and np.nanmax(measurement.beam_angle_deg) - np.nanmin(measurement.beam_angle_deg) > 0.0:
        angles = f"up to {angles}"
    return f"{what} {place}: {beams} Beam{'s' if beams > 1 else ''} at {angles}"


def _draw_values(figure: SubFigure, measurement: Measurement, faults: Sequence[Fault]) -> None:
    beams = list(range(measurement.beam_count))
    rows = [[beam] for beam in beams] if len(beams) <= _SEPARATE_BEAMS else [beams]
    ratios = (max(2.2, 0.75 * len(rows)), *([1.0] * len(rows)))
    panels = figure.subplots(
        1 + len(rows), 2, sharex=True, squeeze=False, height_ratios=ratios if len(rows) > 1 else (1.0, 1.0)
    )
    measured = (
        ("Range (m)", measurement.range_m, measurement.true_range_m),
        ("Closing speed (m/s)", measurement.closing_speed_mps, measurement.true_closing_speed_mps),
    )
    for column, (quantity, (label, values, true)) in enumerate(
        zip(error_values(measurement), measured, strict=True)
    ):
        top, *below = panels[:, column]
        top.set_title(label, loc="left")
        _add_values(top, measurement, values, true, quantity)
        limits = quantity.limits()
        for axes, shown in zip(below, rows, strict=True):
            _add_errors(axes, measurement, quantity, limits, shown)
            named = f"beam {shown[0]}" if len(shown) == 1 else f"{len(shown)} beams"
            axes.set_ylabel(f"{named}\n{_mean_and_rms(quantity, shown)}", fontsize=8)
        below[0].set_title(f"{quantity.quantity.capitalize()} error ({quantity.unit})", loc="left")
        below[-1].set_xlabel("time (s)")
        for axes in (top, *below):
            _add_marks(axes, measurement, faults)
        for change in pattern_changes(measurement):
            at_s = measurement.time_s[change.shot, 0]
            top.annotate(str(change), (at_s, 1.0), (4.0, -2.0), xycoords=("data", "axes fraction"),
                         textcoords="offset points", va="top", fontsize=8)  # fmt: skip
    _add_keys(panels, measurement, faults)


def _mean_and_rms(quantity: ErrorValues, beams: list[int]) -> str:
    error = quantity.error[:, beams][quantity.valid[:, beams]]
    error = error[np.isfinite(error)]
    if not error.size:
        return "no errors"
    return f"mean {error.mean():.2g}\nrms {np.sqrt(np.mean(error**2)):.3g}".replace("-", "−")


def _add_values(
    axes: Axes, measurement: Measurement, values: FloatArray, true: FloatArray, quantity: ErrorValues
) -> None:
    limits, time_s = truth_limits(values[quantity.valid], true), measurement.time_s
    for beam in range(measurement.beam_count):
        axes.plot(time_s[:, beam], true[:, beam], color=GRID, linewidth=0.8, zorder=1)
        valid = quantity.valid[:, beam]
        limited_points(axes, beam, measurement.beam_count, time_s[valid, beam], values[valid, beam], limits)
    axes.margins(x=0.01)


def _add_errors(
    axes: Axes, measurement: Measurement, quantity: ErrorValues, limits: Limits, beams: list[int]
) -> None:
    size = 8.0 if len(measurement) <= FEW_SHOTS else 3.0
    axes.axhline(0, color=GRID, linewidth=0.8, zorder=1)
    axes.set_ylim(limits)
    for beam in beams:
        time_s, colour, valid = measurement.time_s[:, beam], beam_colour(beam), quantity.valid[:, beam]
        shown = valid & limits.contain(quantity.error[:, beam])
        axes.plot(time_s[shown], quantity.error[shown, beam], ".", color=colour, markersize=size,
                  markeredgewidth=0, rasterized=True, zorder=2)  # fmt: skip
        mark_outside(axes, colour, time_s[valid], quantity.error[valid, beam], limits)
        lost_s = time_s[measurement.fired[:, beam] & ~valid]
        axes.plot(lost_s, np.full(len(lost_s), 0.05), "|", color=INK, markersize=5, markeredgewidth=0.8,
                  transform=axes.get_xaxis_transform(), zorder=3)  # fmt: skip
    valid = quantity.valid[:, beams]
    add_sigma_band(axes, measurement.time_s[:, beams][valid], quantity.sigma[:, beams][valid])
    axes.margins(x=0.01)


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


def _add_keys(panels: Any, measurement: Measurement, faults: Sequence[Fault]) -> None:
    """Add the keys to the right of the panels: beams beside the values, marks beside the errors."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    def mark(marker: str, label: str, colour: str = GRID) -> Line2D:
        return Line2D([], [], linestyle="", marker=marker, color=colour, markersize=6, label=label)

    beams = measurement.beam_count
    above: list[Any] = [
        mark("o", _beams_of_colour(colour, beams), beam_colour(colour))
        for colour in range(min(beams, len(BEAM_COLOURS)))
    ]
    above.append(Line2D([], [], color=GRID, linewidth=0.8, label="ground truth"))
    if pattern_changes(measurement):
        above.append(Line2D([], [], label="change of pattern", **_CHANGE))
    if faults:
        kinds = ", ".join(dict.fromkeys(fault.kind.replace("_", " ") for fault in faults))
        above.append(Patch(color=FAULT_COLOUR, alpha=0.3, linewidth=0, label=f"fault: {kinds}"))
    below: list[Any] = [
        mark(".", "error, valid"),
        mark("^", "beyond the axis"),
        Patch(color=GRID, alpha=0.3, linewidth=0, label="±2σ as stated"),
        mark("|", "dropout", INK),
    ]
    if measurement.true_in_gap.any():
        below.append(Patch(color=BRIDGE_COLOUR, alpha=0.3, linewidth=0, label="bridged gap"))
    for row, handles in ((0, above), (1, below)):
        panels[row, 1].legend(handles=handles, loc="upper left", bbox_to_anchor=(1.0, 1.05), handletextpad=0.5,
                              borderaxespad=0.3)  # fmt: skip


def _beams_of_colour(first: int, beam_count: int) -> str:
    beams = [str(beam) for beam in range(first, beam_count, len(BEAM_COLOURS))]
    if beam_count > MOST_COLOURED_BEAMS:
        return f"beams {beams[0]}, {beams[1]}, …"
    return f"beam{'s' if len(beams) > 1 else ''} {', '.join(beams)}"


def _bridges(measurement: Measurement) -> list[tuple[float, float]]:
    inside = np.any(measurement.true_in_gap, axis=1)
    turns = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
    time_s = measurement.time_ns[:, 0] * 1e-9
    return [(time_s[first], time_s[end - 1]) for first, end in turns.reshape(-1, 2)]
