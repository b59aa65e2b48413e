"""The figure of a hazard map: ground and hazards, points, safe probability, and how far to trust them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.beam_colours import beam_colour
from lidar_emu.report.ground_plots import draw_map
from lidar_emu.report.ground_survey import GroundSurvey
from lidar_emu.report.hazard_map import HazardMap, Lander
from lidar_emu.report.hazard_regions import (
    DetectionTally,
    TrueHazard,
    by_height,
    by_probability,
    detected_points,
)
from lidar_emu.report.hazards import CELL_M, Cloud
from lidar_emu.report.plot_style import GRID, INK, styled, titled_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

_SIZE_INCH, _DOTS_PER_INCH = (8.4, 12.4), 145
_COLOURS = {True: "#1f6fd0", False: "#d81b78"}
"""Colours of hazards that are detected, and missed, of a contrast above 3.5 on white and on dark paper."""
_NAMES = {"boulder": "boulder, rim", "crater": "crater", "step": "step"}
_UNKNOWN = "#d5d8dc"
"""Colour where too few points are."""
_ABOVE: Any = {
    "loc": "lower left",
    "bbox_to_anchor": (-0.02, 0.98),
    "handletextpad": 0.4,
}
_FEW_POINTS = 8000
_CLOSE_M = 5.0
"""Side of the frame in which single points are shown."""


@styled
def draw_hazards(
    cloud: Cloud,
    found: HazardMap,
    truth: GroundSurvey,
    slope_deg: FloatArray,
    flown: DetectionTally,
    tally: DetectionTally,
    title: str,
) -> Figure:
    """Draw a figure of 1218 by 1798 dots.

    Args:
        cloud: points of a flight.
        found: the flight's map.
        truth: the ground of the map.
        slope_deg: its slope under the lander's footprint about each cell.
        flown: hazards of the flight.
        tally: counts of all flights.
        title: title of the figure.
    """
    figure = titled_figure(title, _SIZE_INCH, 13, dpi=_DOTS_PER_INCH)
    parts: Any = figure.subfigures(3, 1, height_ratios=(2.3, 0.21, 1.0))
    above, between, below = parts
    maps = above.subplots(4, 2, height_ratios=(1.0, 0.04, 1.0, 0.04))
    detection, reliability = below.subplots(1, 2)
    step_m, area = found.lander.step_m, truth.area
    hazards = [hazard for hazard in flown.hazards if abs(hazard.height_m) >= step_m]
    ground, safe, points, close = maps[::2].ravel()
    _draw_ground(ground, maps[1, 0], truth, slope_deg, found.lander)
    _draw_safe(safe, maps[1, 1], found)
    _draw_points(points, truth, cloud, 3.0 if len(cloud.seen_m) < _FEW_POINTS else 1.5, 0.0)
    points.set_title(f"{len(cloud.seen_m)} points measured", loc="left")
    _draw_points(close, truth, cloud, 10.0, 0.5)
    close.set_title("Points in the black square", loc="left")
    _name_points(close, maps[3], cloud, step_m)
    for axes in (ground, points, close):
        for hazard in hazards:
            _draw_symbol(hazard, axes.add_artist)
    for axes in (ground, safe, points):
        axes.set(xlim=(area.west_m, area.east_m), ylim=(area.south_m, area.north_m))
    _enlarge(close, points, hazards, cloud)
    _name_symbols(between, hazards, found)
    _draw_detection(detection, tally, step_m)
    _draw_reliability(reliability, tally)
    return figure


def _draw_ground(axes: Axes, key: Axes, truth: GroundSurvey, slope_deg: FloatArray, lander: Lander) -> None:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    slopes = ScalarMappable(Normalize(0.0, 2 * lander.slope_deg), colormaps["YlOrBr"])
    fine_deg = np.kron(np.nan_to_num(slope_deg), np.ones([round(CELL_M / step_m) for step_m in truth.step_m]))
    colours = slopes.to_rgba(fine_deg)[..., :3] * _shade(truth)[..., None]
    colours[np.isnan(truth.up_m)] = 1.0
    draw_map(axes, truth, np.clip(colours, 0.0, 1.0))
    label = f"true slope over {lander.footprint_m:g} m (°); line: the lander's limit"
    ticks = np.linspace(0.0, 2 * lander.slope_deg, 5)
    axes.figure.colorbar(slopes, cax=key, orientation="horizontal", extend="max", label=label, ticks=ticks)
    key.axvline(lander.slope_deg, color=INK)
    axes.set_title("True ground with its hazards", loc="left")


def _shade(truth: GroundSurvey) -> FloatArray:
    return np.asarray(0.3 + 0.7 * np.nan_to_num(truth.shade, nan=0.6))


def _draw_points(axes: Axes, truth: GroundSurvey, cloud: Cloud, size: float, edge: float) -> None:
    draw_map(axes, truth, _shade(truth), cmap="gray", vmin=0.0, vmax=1.0)
    for beam in np.unique(cloud.seen_beam):
        own_m = cloud.seen_m[cloud.seen_beam == beam]
        axes.plot(
            own_m[:, 0], own_m[:, 1], ".", color=beam_colour(int(beam)), markersize=size, markeredgewidth=edge,
            markeredgecolor="black", rasterized=True, zorder=3 if edge else 0.5,
        )  # fmt: skip


def _name_points(axes: Axes, keys: Sequence[Axes], cloud: Cloud, step_m: float) -> None:
    """Ring the points that are detected as hazards, and name these and the beams."""
    at_m = cloud.seen_m[cloud.own[detected_points(cloud, step_m)]]
    ring: Any = {"color": _COLOURS[True], "markersize": 11, "markerfacecolor": "none", **_around("white")}
    axes.plot(at_m[:, 0], at_m[:, 1], "o", zorder=4, **ring)
    for beam in np.unique(cloud.seen_beam)[:8]:
        keys[0].plot([], [], ".", color=beam_colour(int(beam)), label=f"beam {beam}", markersize=9)
    keys[1].plot([], [], "o", label="detected as a hazard", **ring)
    for key in keys:
        key.set_axis_off()
        key.legend(loc="upper center", ncols=4, columnspacing=1.0, handletextpad=0.1)


def _enlarge(axes: Axes, whole: Axes, hazards: list[TrueHazard], cloud: Cloud) -> None:
    """Limit axes to the surroundings of the hazard in the middle, and frame them on the whole map."""
    from matplotlib.patches import Rectangle

    middle_m = tuple(np.median(cloud.seen_m[:, :2], axis=0).tolist())
    places_m = [(hazard.east_m, hazard.north_m) for hazard in hazards] or [middle_m]
    east_m, north_m = min(places_m, key=lambda place_m: np.hypot(*np.subtract(place_m, middle_m)))
    west_m, south_m = east_m - _CLOSE_M / 2, north_m - _CLOSE_M / 2
    axes.set(xlim=(west_m, west_m + _CLOSE_M), ylim=(south_m, south_m + _CLOSE_M))
    frame: Any = {"fill": False, "edgecolor": "black", "linewidth": 1.2}
    whole.add_patch(Rectangle((west_m, south_m), _CLOSE_M, _CLOSE_M, **frame))


class _Symbol(NamedTuple):
    """Whatever a map and a legend draw alike: a function of where it is added, the centre and the size there."""

    draw: Callable[[Callable[[Any], Any], tuple[float, float], float], None]

    def legend_artist(self, _legend: Any, handle: _Symbol, _size: float, box: Any) -> None:
        """Draw a symbol in a legend, as matplotlib's handlers do."""

        def add(artist: Any) -> None:
            artist.set_transform(box.get_transform())
            box.add_artist(artist)

        handle.draw(add, (box.width / 2 - box.xdescent, box.height / 2 - box.ydescent), box.height)


def _draw_symbol(hazard: TrueHazard, add: Callable[[Any], Any]) -> None:
    """Draw an ellipse, or a rectangle for a step, and a triangle: up for a boulder, down for a crater."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Ellipse, Rectangle

    place, length, width = (hazard.east_m, hazard.north_m), hazard.length_m, hazard.width_m
    colour, how = _COLOURS[hazard.detected], _around("white")
    shape: Any = {
        "angle": float(np.degrees(hazard.azimuth_rad)), "fill": False, "edgecolor": colour, "linewidth": 1.3,
        "linestyle": "-" if hazard.detected else (0, (2, 1)), **how,
    }  # fmt: skip
    if hazard.kind == "step":
        corner = place[0] - length / 2, place[1] - width / 2
        add(Rectangle(corner, length, width, rotation_point="center", **shape))
        return
    add(Ellipse(place, length, width, **shape))
    add(
        Line2D(
            [place[0]], [place[1]], marker="^" if hazard.kind == "boulder" else "v", markersize=4.5,
            markeredgecolor=colour, markerfacecolor=colour if hazard.detected else "white", **how,
        )
    )  # fmt: skip


def _around(colour: str) -> Any:
    """Outline of a symbol, so that it is seen on bright and on dark ground."""
    from matplotlib.patheffects import withStroke

    return {"path_effects": [withStroke(linewidth=2.6, foreground=colour)]}


def _draw_lander(add: Callable[[Any], Any], place: tuple[float, float], diameter: float) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Circle

    add(Circle(place, diameter / 2, fill=False, edgecolor="white", linewidth=1.6, **_around(INK)))
    add(Line2D([place[0]], [place[1]], marker="+", color="white", markersize=8, **_around(INK)))


def _draw_safe(axes: Axes, key: Axes, found: HazardMap) -> None:
    survey = GroundSurvey("", found.east_m, found.north_m, found.height_m, None)
    axes.set_facecolor(_UNKNOWN)
    image = draw_map(axes, survey, found.safe_probability, cmap="cividis", vmin=0.0, vmax=1.0)
    lander = found.lander
    label = f"probability that a landing area {lander.footprint_m:g} m wide is safe"
    axes.figure.colorbar(image, cax=key, orientation="horizontal", label=label)
    axes.set_title(f"Safe: slope < {lander.slope_deg:g}°, steps < {lander.step_m:g} m", loc="left")
    if np.isfinite(found.safe_probability).any():
        _draw_lander(axes.add_artist, _safest(found)[0], lander.footprint_m)


def _safest(found: HazardMap) -> tuple[tuple[float, float], float]:
    """Place with the highest mean safe probability in a square of a footprint about it, and the probability there."""
    known = np.nan_to_num(found.safe_probability)
    around = uniform_filter(known, round(found.lander.footprint_m / CELL_M), mode="constant")
    row, column = np.unravel_index(np.argmax(np.where(known > 0, around, -1.0)), around.shape)
    return (float(found.east_m[column]), float(found.north_m[row])), float(known[row, column])


def _name_symbols(figure: SubFigure, hazards: list[TrueHazard], found: HazardMap) -> None:
    from matplotlib.patches import Rectangle

    keys: dict[str, Any] = {}
    for is_found in (True, False):
        for kind, name in _NAMES.items():
            count = sum((hazard.kind, hazard.detected) == (kind, is_found) for hazard in hazards)
            keys[f"{name}, {'detected' if is_found else 'missed'} ({count})"] = _symbol_of(kind, is_found)
    if np.isfinite(found.safe_probability).any():
        keys[f"lander where it is safest ({_safest(found)[1]:.2f})"] = _Symbol(_draw_lander)
    keys["too few points"] = _Symbol(
        lambda add, at, size: add(
            Rectangle((at[0] - size, at[1] - size / 2), 2 * size, size, facecolor=_UNKNOWN, edgecolor=INK)
        )
    )
    figure.legend(
        list(keys.values()), list(keys), handler_map={_Symbol: _Symbol(_draw_lander)}, loc="center", ncols=3,
        handleheight=1.5, handlelength=2.8, columnspacing=2.0,
        title=f"Hazards of one flight, {found.lander.step_m:g} m or more up or down, outlined in true size",
    )  # fmt: skip


def _symbol_of(kind: str, detected: bool) -> _Symbol:
    """Symbol of a kind of hazards as on the map, for a legend."""
    long, height = (4.0, 1.0) if kind == "step" else (1.6, 1.0 if kind == "boulder" else -1.0)

    def draw(add: Callable[[Any], Any], at: tuple[float, float], size: float) -> None:
        width = size * (0.55 if kind == "step" else 1.0)
        _draw_symbol(TrueHazard(*at, height, long * width, width, 0.0, True, detected), add)

    return _Symbol(draw)


def _draw_detection(axes: Axes, tally: DetectionTally, step_m: float) -> None:
    rows = by_height(tally.hazards, step_m)
    known = [row for row in rows if row.hazards]
    middle_m = [np.sqrt(row.low_m * row.high_m) for row in known]
    share = np.array([row.detected / row.hazards for row in known])
    bounds = np.array([row.interval for row in known]).reshape(-1, 2).T
    axes.errorbar(
        middle_m, 100 * share, 100 * np.abs(bounds - share), fmt="o-", color=_COLOURS[True], capsize=3,
        label="detected, 95 % interval",
    )  # fmt: skip
    touched = [100 * row.touched / row.hazards for row in known]
    axes.plot(middle_m, touched, "s:", color="0.45", label="with a point on it")
    for at_m, row in zip(middle_m, known, strict=True):
        axes.annotate(str(row.hazards), (at_m, 107), fontsize=8, ha="center", annotation_clip=False)
    low, high = tally.alarm_interval
    above = sum(row.hazards for row in rows if row.low_m >= step_m * (1 - 1e-9))
    axes.axvline(step_m, color=INK, linewidth=0.8, linestyle="--", label="the lander's limit")
    axes.set(xscale="log", ylim=(-4, 120), ylabel="probability of detection (%)")
    found = f"All flights: {len(tally.hazards)} features from {step_m / 2:g} m"
    title = f"{found},\n{above} of them above the limit of {step_m:g} m"
    axes.set_title(title, loc="left", pad=48)
    ticks = [
        tick
        for tick in (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 2.0, 3.0, 5.0, 10.0)
        if rows and rows[0].low_m < tick < rows[-1].high_m
    ]
    axes.minorticks_off()
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    words = f"false alarms: {tally.alarms} of {tally.level} points ({100 * low:.2g} to {100 * high:.2g} %)"
    axes.set_xlabel(f"height above or below the surroundings (m)\nnumbers: features\n{words}")
    axes.legend(**_ABOVE)


def _draw_reliability(axes: Axes, tally: DetectionTally) -> None:
    rows = by_probability(tally)
    stated = [row.stated for row in rows]
    axes.plot([0, 1], [0, 100], color=GRID, linewidth=1.0, label="as stated")
    axes.plot(
        stated, [100 * row.safe for row in rows], "o-", color=_COLOURS[True], label="found on the true ground"
    )
    for place, row in enumerate(rows):
        axes.annotate(str(row.landing_areas), (row.stated, -16 - 11 * (place % 2)), fontsize=8, ha="center")
    axes.set(
        xlim=(-0.1, 1.08), ylim=(-32, 105), yticks=(0, 25, 50, 75, 100), ylabel="share that is safe (%)",
        xlabel="safe probability stated\nnumbers: landing areas",
    )  # fmt: skip
    axes.set_title("All flights: safe probability, stated and found", loc="left", pad=34)
    axes.legend(**_ABOVE)
