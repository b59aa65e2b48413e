"""Figure of the true motion of a vehicle: height, speed and attitude over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.page_style import Drawing, draw_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lidar_emu.scene.ray_hits import Scene

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
