"""An oblique view of a flight: shaded ground, path, and the beams down to their footprints, in parallel projection."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.beam_colours import BEAM_COLOURS, beam_colour
from lidar_emu.report.ground_survey import Extent, extent_of, hill_shade, sample_ground
from lidar_emu.report.plot_style import INK, distinct

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from lidar_emu.scene.ray_hits import Scene

MOST_COLOURED_BEAMS = 16
"""Largest number of beams whose points have the beam's colour; the points of more have a colour by height."""
FEW_SHOTS = 100
_GROUND_SAMPLES = 400
_LEAST_ELEVATION_DEG, _MOST_ELEVATION_DEG, _AZIMUTH_DEG = 27.0, 38.0, 22.0
"""Direction of the view: downward from the horizon, and clockwise from north or from across the path."""
_FLAT, _FLAT_ELEVATION_DEG, _FLAT_AZIMUTH_DEG = 2.5, 55.0, 45.0
"""Width of the box over its height above which the view is steeper, up to this elevation, and along a diagonal."""
_SHAPE = 1.1
"""Height of the drawing over its width, as near as the limits of the elevation allow."""
_LEAST_HEIGHT_SHARE = 0.3
"""Height of the drawing as a share of its width, to which the heights of a flat flight are stretched."""
LEVEL_SHARE = 0.05
"""Share of its height by which a flight may climb or sink, to be stated with one height."""
_TICK: Any = {"arrowstyle": "-", "color": INK, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 0}
_LABEL = (0.16, 0.06)
"""Width and height of the label of a height, over the width of the view."""
_ON_PLATE = "#f4f5f6"
_PLATE: Any = {"facecolor": "#2a2f37", "alpha": 0.85, "linewidth": 0, "pad": 2.0}
"""Colours of labels that are legible on paper and ground, light and dark."""
_RAYS = 7
_CURTAIN_POINTS = 120
_CURTAIN_ALPHA = 0.3
"""Opacity of all beams' surfaces together."""


class ObliqueView(NamedTuple):
    """A parallel projection of the site frame, and what it shows."""

    extent: Extent
    stretch: float
    """Factor on heights."""
    ahead: FloatArray
    """(2,) Horizontal direction of the view, east and north."""
    elevation_deg: float
    """Angle of the view below the horizon."""

    def project(self, site_m: FloatArray) -> FloatArray:
        """(..., 2) Coordinates across and upward of points (..., 3)."""
        elevation = np.radians(self.elevation_deg)
        across = site_m[..., 0] * self.ahead[1] - site_m[..., 1] * self.ahead[0]
        depth = site_m[..., 0] * self.ahead[0] + site_m[..., 1] * self.ahead[1]
        upward = np.sin(elevation) * depth + np.cos(elevation) * self.stretch * site_m[..., 2]
        return np.stack([across, upward], axis=-1)

    @property
    def width(self) -> float:
        """Width of the box, projected."""
        return float((self.extent.high_m - self.extent.low_m)[:2] @ np.abs(self.ahead[::-1]))

    @classmethod
    def around(cls, measurement: Measurement) -> ObliqueView:
        """View a flight across its path, or toward the north-east if it is vertical."""
        extent = extent_of(measurement).with_ground()
        half_m = (extent.high_m - extent.low_m) / 2
        position_m = measurement.position_site_m
        position_m = position_m[np.isfinite(position_m).all(axis=1)]
        travel_m = position_m[-1, :2] - position_m[0, :2]
        is_flat = half_m[:2].max() > _FLAT * half_m[2]
        azimuth = np.radians(_FLAT_AZIMUTH_DEG if is_flat else _AZIMUTH_DEG)
        if np.hypot(*travel_m) > 0.3 * half_m[:2].max():
            azimuth += np.arctan2(travel_m[1], -travel_m[0])
            if np.cos(azimuth) < 0.0:
                azimuth += np.pi
        stretch = max(1.0, _LEAST_HEIGHT_SHARE * float(half_m[:2].max() / half_m[2]))
        ahead = np.array([np.sin(azimuth), np.cos(azimuth)])
        depth_m = half_m[:2] @ np.abs(ahead)
        most_deg = _FLAT_ELEVATION_DEG if is_flat else _MOST_ELEVATION_DEG
        elevations_deg = np.linspace(_LEAST_ELEVATION_DEG, most_deg, 24)
        upward_m = depth_m * np.sin(np.radians(elevations_deg))
        upward_m += stretch * half_m[2] * np.cos(np.radians(elevations_deg))
        shape = upward_m / (half_m[:2] @ np.abs(ahead[::-1]))
        elevation_deg = float(elevations_deg[np.abs(shape - _SHAPE).argmin()])
        return cls(extent, stretch, ahead, elevation_deg)


def draw_oblique_view(
    axes: Axes, measurement: Measurement, scene: Scene | None, moving: Mapping[int, str] | None = None
) -> Any:
    """Draw a flight on axes that it fills; returns the points with a colour by height, or None.

    Valid points have the beam's colour up to 16 beams; crosses are the true hit points of beams that fired without a
    valid range. `moving` has names of moving objects, by their number; their points are labelled.
    """
    view = ObliqueView.around(measurement)
    axes.set_axis_off()
    axes.set_aspect("equal")
    base_m = view.extent.low_m[2]
    if scene is not None:
        ground_m = sample_ground(scene, view.extent, _GROUND_SAMPLES)
        _add_ground(axes, view, ground_m)
        edge_m = np.concatenate(
            [ground_m[0, :, 2], ground_m[-1, :, 2], ground_m[:, 0, 2], ground_m[:, -1, 2]]
        )
        base_m = np.median(edge_m[np.isfinite(edge_m)]) if np.isfinite(edge_m).any() else base_m
    _add_frame(axes, view, float(base_m))
    if measurement.beam_count <= MOST_COLOURED_BEAMS:
        _add_curtains(axes, view, measurement)
    points = _add_points(axes, view, measurement)
    _add_path(axes, view, measurement, scene)
    _add_heights(axes, view, measurement.position_site_m)
    for number, name in (moving or {}).items():
        seen = measurement.range_valid & (measurement.true_object == number)
        if seen.any():
            place = view.project(np.median(measurement.point_site_m[seen], axis=0))
            _add_label(axes, name, place, (0.0, 12.0), ha="center", va="bottom", arrowprops=_TICK)
    axes.margins(0.03)
    return points


def _add_ground(axes: Axes, view: ObliqueView, ground_m: FloatArray) -> None:
    # A mesh is painted in its order: the far quadrilaterals first.
    far_first = tuple(slice(None, None, -1 if forward > 0.0 else 1) for forward in view.ahead[::-1])
    at = view.project(np.nan_to_num(ground_m))[far_first]
    known = ~np.isnan(ground_m[..., 2])
    known = known[:-1, :-1] & known[:-1, 1:] & known[1:, 1:] & known[1:, :-1]
    if not known.any():
        return
    light = np.nan_to_num(hill_shade(ground_m), nan=0.6)[far_first]
    rgba = np.stack([*([0.22 + 0.78 * light] * 3), known[far_first]], axis=-1)
    axes.pcolormesh(
        at[..., 0],
        at[..., 1],
        rgba,
        shading="flat",
        antialiased=False,
        rasterized=True,
        zorder=1,
        linewidth=0,
    )


def _add_frame(axes: Axes, view: ObliqueView, base_m: float) -> None:
    """Draw scales of east and north along the near edges of the ground."""
    low_m, high_m = view.extent.low_m, view.extent.high_m
    near = np.where(view.ahead > 0.0, low_m[:2], high_m[:2])
    for axis, name in enumerate(("east (m)", "north (m)")):
        begin_m = np.array([*near, base_m])
        end_m = begin_m.copy()
        begin_m[axis], end_m[axis] = low_m[axis], high_m[axis]
        _add_scale(axes, view, begin_m, end_m, axis, name)


def _add_scale(
    axes: Axes, view: ObliqueView, begin_m: FloatArray, end_m: FloatArray, axis: int, name: str
) -> None:
    ends = view.project(np.stack([begin_m, end_m]))
    axes.plot(*ends.T, color=INK, linewidth=0.8, zorder=1.5)
    ticks_m = _ticks(view, ends, begin_m[axis], end_m[axis])
    at_m = np.repeat(begin_m[None], len(ticks_m), axis=0)
    at_m[:, axis] = ticks_m
    middle = view.project((view.extent.low_m + view.extent.high_m) / 2)
    outward = np.array([np.sign(ends.mean(axis=0)[0] - middle[0]), -1.6])
    side = "right" if outward[0] < 0.0 else "left"
    for place, tick in zip(view.project(at_m), ticks_m, strict=True):
        label = f"{tick:g}".replace("-", "−")
        axes.annotate(label, place, tuple(5.0 * outward), textcoords="offset points", ha=side, va="center",
                      fontsize=8, arrowprops=_TICK)  # fmt: skip
    offset = 26.0 * outward / np.hypot(*outward) * np.array([1.3, 1.0])
    axes.annotate(name, ends.mean(axis=0), offset, textcoords="offset points", ha=side, va="center")


def _ticks(view: ObliqueView, ends: FloatArray, low_m: float, high_m: float) -> list[float]:
    """Round values from one to the other, as many as fit between the projected ends."""
    from matplotlib.ticker import MaxNLocator

    length = float(np.hypot(*(ends[1] - ends[0])))
    steps = MaxNLocator(nbins=round(np.clip(7.0 * length / view.width, 2, 6)), steps=[1, 2, 2.5, 5, 10])
    return [tick for tick in steps.tick_values(low_m, high_m) if low_m <= tick <= high_m]


def _add_heights(axes: Axes, view: ObliqueView, position_m: FloatArray) -> None:
    """Label the path where it begins and where it first has round heights: an axis elsewhere has another depth."""
    position_m = position_m[np.isfinite(position_m).all(axis=1)]
    up_m = position_m[:, 2]
    if np.ptp(up_m) <= LEVEL_SHARE * abs(up_m[0]):
        return
    ends = view.project(position_m[[0, -1]])
    right, up = ends[1] - ends[0]
    # Beside a steep path; else above it, on the side from which it descends.
    side = 1.0 if right * up < 0.0 else -1.0
    offset, upward = ((5.0 * side, 11.0), "bottom") if abs(right) > abs(up) else ((-9.0, 0.0), "center")
    across = "left" if offset[0] > 0.0 else "right"
    labelled: list[FloatArray] = []
    for tick in [up_m[0], *_ticks(view, ends, up_m.min(), up_m.max())]:
        above_m = up_m - tick
        before = int(np.argmax(above_m[:-1] * above_m[1:] <= 0.0))
        share = above_m[before] / ((above_m[before] - above_m[before + 1]) or 1.0)
        place = view.project(position_m[before] + share * (position_m[before + 1] - position_m[before]))
        if any((np.abs(place - other) < np.array(_LABEL) * view.width).all() for other in labelled):
            continue
        labelled.append(place)
        _add_label(axes, f"{tick:.4g} m", place, offset, ha=across, va=upward, arrowprops=_TICK)


def _add_curtains(axes: Axes, view: ObliqueView, measurement: Measurement) -> None:
    """Draw the surface that each beam sweeps, and single beams at some places of the path."""
    position_m, hit_m = measurement.position_site_m, measurement.true_point_site_m
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(view.project(position_m), axis=0).T))])
    alpha = _CURTAIN_ALPHA / max(measurement.beam_count, 3)
    turns = [0, *np.flatnonzero(np.diff(measurement.pattern)) + 1, len(measurement)]
    for beam in range(measurement.beam_count):
        colour = beam_colour(beam)
        known = np.isfinite(hit_m[:, beam, 2]) & np.isfinite(position_m[:, 2])
        for first, end in pairwise(turns):
            shots = first + np.flatnonzero(known[first:end])
            if len(shots):
                shots = shots[np.unique(np.linspace(0, len(shots) - 1, _CURTAIN_POINTS).astype(np.int64))]
                outline = view.project(np.concatenate([position_m[shots], hit_m[shots[::-1], beam]]))
                axes.fill(*outline.T, color=colour, alpha=alpha, linewidth=0, zorder=2)
        shots = np.flatnonzero(known)
        if len(shots):
            places = np.linspace(travelled[shots[0]], travelled[shots[-1]], _RAYS)[:-1]
            rays = shots[np.searchsorted(travelled[shots], places).clip(max=len(shots) - 1)]
            ends = view.project(np.stack([position_m[rays], hit_m[rays, beam]], axis=1))
            axes.plot(
                *np.moveaxis(ends, 0, -1).transpose(1, 0, 2),
                color=colour,
                linewidth=0.7,
                alpha=0.6,
                zorder=2.2,
            )


def _add_points(axes: Axes, view: ObliqueView, measurement: Measurement) -> Any:
    few = len(measurement) <= FEW_SHOTS
    inside = measurement.range_valid & view.extent.contain(measurement.point_site_m)
    at, drawn = view.project(measurement.point_site_m), None
    if measurement.beam_count <= MOST_COLOURED_BEAMS:
        for beam in range(measurement.beam_count):
            x, y = at[inside[:, beam], beam].T
            shown = distinct(x, y)
            axes.plot(x[shown], y[shown], ".", color=beam_colour(beam), markersize=6.0 if few else 4.0,
                      markeredgewidth=0, rasterized=True, zorder=3)  # fmt: skip
    else:
        from matplotlib.colors import LinearSegmentedColormap

        x, y = at[inside].T
        # Colours that are as legible on dark paper as on white.
        by_height = LinearSegmentedColormap.from_list("", [BEAM_COLOURS[each] for each in (0, 3, 2, 1)])
        far_first = np.argsort(-y, kind="stable")
        drawn = axes.scatter(x[far_first], y[far_first], c=measurement.point_site_m[inside][far_first, 2], s=3.0,
                             linewidths=0, rasterized=True, zorder=3, cmap=by_height)  # fmt: skip
    lost = measurement.fired & ~measurement.range_valid & np.isfinite(measurement.true_point_site_m[..., 2])
    if lost.any():
        x, y = view.project(measurement.true_point_site_m[lost]).T
        label = f"dropouts, at the true hit point ({lost.sum()})"
        axes.plot(x, y, "x", color=INK, markersize=4.0, markeredgewidth=0.7, zorder=4, label=label,
                  path_effects=on_ground(1.1))  # fmt: skip
    if outside := np.count_nonzero(measurement.range_valid & ~inside):
        axes.plot([], [], " ", label=f"{outside} points outside the view")
    return drawn


def _add_path(axes: Axes, view: ObliqueView, measurement: Measurement, scene: Scene | None) -> None:
    position_m = measurement.position_site_m
    at = view.project(position_m)
    if scene is not None:
        below_m = np.column_stack([position_m[:, :2], scene.height_m(*position_m[:, :2].T)])
        axes.plot(*view.project(below_m).T, color="black", linewidth=1.0, alpha=0.45, zorder=1.8)
    few = len(measurement) <= FEW_SHOTS
    larger = f"; heights drawn {view.stretch:.2g} times as large" if view.stretch > 1.05 else ""
    axes.plot(*at.T, color=INK, linewidth=2.0, marker="o" if few else "", markersize=3.5, zorder=5,
              label="path, with heights above the origin" + larger, path_effects=on_ground(3.4))  # fmt: skip
    gap = np.any(measurement.true_in_gap, axis=1)
    if gap.any():
        axes.plot(*np.where(gap[:, None], at, np.nan).T, color=BRIDGE_COLOUR, linewidth=2.0, zorder=5,
                  label="bridged gap in the table")  # fmt: skip
    for change in pattern_changes(measurement):
        place = at[change.shot]
        axes.plot(*place, "o", color="white", markeredgecolor=INK, markersize=7.0, zorder=6)
        _add_label(axes, f"{change} at {change.up_m:.0f} m", place, (9.0, 0.0), va="center")


def _add_label(axes: Axes, text: str, place: Any, offset: tuple[float, float], **how: Any) -> None:
    axes.annotate(
        text,
        place,
        offset,
        textcoords="offset points",
        fontsize=8,
        zorder=7,
        color=_ON_PLATE,
        bbox=_PLATE,
        **how,
    )


def on_ground(width: float) -> list[Any]:
    """Effects that outline lines darkly: on a dark page they are light, and would be lost on the ground."""
    from matplotlib.patheffects import Normal, Stroke

    return [Stroke(linewidth=width, foreground="black", alpha=0.45), Normal()]


BRIDGE_COLOUR = "#e0a030"
_MOST_CHANGES = 4


class PatternChange(NamedTuple):
    """A change of the beams' pattern, and the largest angle of its beams before and after."""

    shot: int
    """Row of its first shot."""
    up_m: float
    """Height of it: the roundest one between the shots before and after."""
    before_deg: float
    after_deg: float

    def __str__(self) -> str:
        return f"{self.before_deg:.3g}° → {self.after_deg:.3g}°"


def pattern_changes(measurement: Measurement) -> list[PatternChange]:
    """Changes of the beams' pattern; none where they are many."""
    shots = np.flatnonzero(np.diff(measurement.pattern)) + 1
    if len(shots) > _MOST_CHANGES:
        return []
    largest_deg, up_m = largest_angle_deg(measurement), measurement.position_site_m[:, 2]
    return [
        PatternChange(
            int(shot),
            _roundest(*up_m[shot - 1 : shot + 1].tolist()),
            *largest_deg[shot - 1 : shot + 1].tolist(),
        )
        for shot in shots
    ]


def _roundest(one: float, other: float) -> float:
    steps = (10.0**power for power in range(4, -1, -1))
    nearest = (step * round((one + other) / 2 / step) for step in steps)
    return next(
        (value for value in nearest if min(one, other) <= value <= max(one, other)), (one + other) / 2
    )


def largest_angle_deg(measurement: Measurement) -> FloatArray:
    """(shots,) Largest published angle of the beams that fired, 0 without any."""
    return np.asarray(np.nan_to_num(measurement.beam_angle_deg).max(axis=1))
