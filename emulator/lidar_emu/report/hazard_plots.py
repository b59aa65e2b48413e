"""The figure of a hazard map: ground and hazards, points, safe probability, and how far to trust them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.beam_colours import beam_colour
from lidar_emu.report.ground_plots import draw_map
from lidar_emu.report.ground_survey import GroundSurvey
from lidar_emu.report.hazard_map import HazardMap
from lidar_emu.report.hazard_regions import DetectionTally, TrueHazard, by_height
from lidar_emu.report.hazards import CELL_M, Cloud
from lidar_emu.report.plot_style import INK, styled, titled_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

_SIZE_INCH, _DOTS_PER_INCH = (11.0, 8.3), 145
_COLOURS = {True: "#0057b8", False: "#d1006c"}
"""Colours of hazards that are detected, and missed."""
_NAMES = {"boulder": "boulder, rim", "crater": "crater", "step": "step"}
_UNKNOWN = "#d5d8dc"
"""Colour where too few points are."""
_ABOVE: Any = {
    "loc": "lower left",
    "bbox_to_anchor": (-0.02, 0.98),
    "ncols": 3,
    "columnspacing": 0.9,
    "handletextpad": 0.4,
}
_FEW_POINTS = 8000
_RELIABILITY = np.array([0.0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98, 1.0 + 1e-9])


@styled
def draw_hazards(
    cloud: Cloud,
    found: HazardMap,
    truth: GroundSurvey,
    flown: DetectionTally,
    tally: DetectionTally,
    title: str,
) -> Figure:
    """Draw a figure of 1595 by 1203 dots.

    Args:
        cloud: points of a flight.
        found: the flight's map.
        truth: the ground of the map.
        flown: hazards of the flight.
        tally: counts of all flights.
        title: title of the figure.
    """
    figure = titled_figure(title, _SIZE_INCH, 13, dpi=_DOTS_PER_INCH)
    parts: Any = figure.subfigures(3, 1, height_ratios=(1.0, 0.16, 0.62))
    above, between, below = parts
    maps, keys = above.subplots(2, 3, height_ratios=(1.0, 0.04))
    detection, reliability = below.subplots(1, 2)
    hazards = [hazard for hazard in flown.hazards if abs(hazard.height_m) >= found.lander.step_m]
    _draw_ground(maps[0], keys[0], truth, found)
    _draw_points(maps[1], keys[1], truth, cloud)
    for axes in maps[:2]:
        for hazard in hazards:
            _draw_symbol(hazard, axes.add_artist)
    _draw_safe(maps[2], keys[2], found)
    area = truth.area
    for axes in maps:
        axes.set(xlim=(area.west_m, area.east_m), ylim=(area.south_m, area.north_m))
        _scale_bar(axes, area.east_m - area.west_m)
    for axes in maps[1:]:
        axes.set_ylabel("")
        axes.tick_params(labelleft=False)
    _name_symbols(between, hazards, found)
    _draw_detection(detection, tally, found.lander.step_m)
    _draw_reliability(reliability, tally)
    return figure


def _draw_ground(axes: Axes, key: Axes, truth: GroundSurvey, found: HazardMap) -> None:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    slopes = ScalarMappable(Normalize(0.0, 2 * found.lander.slope_deg), colormaps["YlOrBr"])
    colours = slopes.to_rgba(np.nan_to_num(truth.slope_deg))[..., :3] * _shade(truth)[..., None]
    colours[np.isnan(truth.up_m)] = 1.0
    draw_map(axes, truth, np.clip(colours, 0.0, 1.0))
    axes.figure.colorbar(
        slopes,
        cax=key,
        orientation="horizontal",
        extend="max",
        label="true slope (°); line: the lander's limit",
    )
    key.axvline(found.lander.slope_deg, color=INK)
    axes.set_title("Ground with its hazards", loc="left")


def _shade(truth: GroundSurvey) -> FloatArray:
    return np.asarray(0.3 + 0.7 * np.nan_to_num(truth.shade, nan=0.6))


def _draw_points(axes: Axes, key: Axes, truth: GroundSurvey, cloud: Cloud) -> None:
    draw_map(axes, truth, _shade(truth), cmap="gray", vmin=0.0, vmax=1.0)
    size = 3.0 if len(cloud.seen_m) < _FEW_POINTS else 1.5
    for beam in np.unique(cloud.seen_beam):
        own_m = cloud.seen_m[cloud.seen_beam == beam]
        axes.plot(
            own_m[:, 0], own_m[:, 1], ".", color=beam_colour(int(beam)), markersize=size, markeredgewidth=0.0,
            rasterized=True,
        )  # fmt: skip
    axes.set_title(f"{len(cloud.seen_m)} points measured", loc="left")
    key.set_axis_off()
    for beam in np.unique(cloud.seen_beam)[:8]:
        key.plot([], [], ".", color=beam_colour(int(beam)), label=f"beam {beam}", markersize=9)
    key.legend(loc="upper center", ncols=4, columnspacing=1.0, handletextpad=0.1)


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
    label = f"safe probability of a lander {lander.footprint_m:g} m wide"
    axes.figure.colorbar(image, cax=key, orientation="horizontal", label=label)
    axes.set_title(f"Safe to land: below {lander.slope_deg:g}° and {lander.step_m:g} m", loc="left")
    if np.isfinite(found.safe_probability).any():
        _draw_lander(axes.add_artist, _safest(found)[0], lander.footprint_m)


def _safest(found: HazardMap) -> tuple[tuple[float, float], float]:
    """Place with the highest mean safe probability in a square of a footprint about it, and the probability there."""
    known = np.nan_to_num(found.safe_probability)
    around = uniform_filter(known, round(found.lander.footprint_m / CELL_M), mode="constant")
    row, column = np.unravel_index(np.argmax(np.where(known > 0, around, -1.0)), around.shape)
    return (float(found.east_m[column]), float(found.north_m[row])), float(known[row, column])


def _scale_bar(axes: Axes, width_m: float) -> None:
    length_m = next(
        step for step in (50.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.5) if step < width_m / 3 or step == 0.5
    )
    transform = axes.get_xaxis_transform()
    start_m = axes.get_xlim()[0] + 0.04 * width_m
    axes.plot([start_m, start_m + length_m], [0.04, 0.04], color="white", linewidth=5, transform=transform)
    axes.plot([start_m, start_m + length_m], [0.04, 0.04], color=INK, linewidth=2, transform=transform)
    axes.text(
        start_m + length_m / 2, 0.055, f"{length_m:g} m", ha="center", va="bottom", transform=transform,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
    )  # fmt: skip


def _name_symbols(figure: SubFigure, hazards: list[TrueHazard], found: HazardMap) -> None:
    from matplotlib.patches import Rectangle

    keys: dict[str, Any] = {}
    for kind, name in _NAMES.items():
        for is_found in (True, False):
            count = sum((hazard.kind, hazard.detected) == (kind, is_found) for hazard in hazards)
            keys[f"{name}, {'detected' if is_found else 'missed'} ({count})"] = _symbol_of(kind, is_found)
    if np.isfinite(found.safe_probability).any():
        keys[f"lander where it is safest ({_safest(found)[1]:.2f})"] = _Symbol(_draw_lander)
    keys["too few points"] = _Symbol(
        lambda add, at, size: add(Rectangle((at[0] - size, at[1] - size / 2), 2 * size, size, color=_UNKNOWN))
    )
    figure.legend(
        list(keys.values()), list(keys), handler_map={_Symbol: _Symbol(_draw_lander)}, loc="center", ncols=4,
        handleheight=1.5, handlelength=2.8, columnspacing=2.0,
        title=f"Hazards from {found.lander.step_m:g} m up or down, in true size",
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
        axes.annotate(str(row.hazards), (at_m, 104), fontsize=8, ha="center", annotation_clip=False)
    low, high = tally.alarm_interval
    count = sum(row.hazards for row in rows)
    title = f"Probability of detection of {count} hazards"
    axes.axvline(step_m, color=INK, linewidth=0.8, linestyle="--", label="step of the lander")
    axes.set(
        xscale="log", ylim=(-4, 114),
        ylabel="probability (%)",
    )  # fmt: skip
    axes.set_title(title, loc="left", pad=20)
    ticks = [
        tick
        for tick in (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 2.0, 3.0, 5.0, 10.0)
        if rows and rows[0].low_m < tick < rows[-1].high_m
    ]
    axes.minorticks_off()
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    words = f"false alarms: {tally.alarms} of {tally.level} points ({100 * low:.2g} to {100 * high:.2g} %)"
    axes.set_xlabel(f"height above or below the surroundings (m); numbers: hazards\n{words}")
    axes.legend(**_ABOVE)


def _draw_reliability(axes: Axes, tally: DetectionTally) -> None:
    number = np.digitize(tally.probability, _RELIABILITY) - 1
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=1.0, label="as stated")
    owns = [number == k for k in np.unique(number)]
    mean, share = ([float(each[own].mean()) for own in owns] for each in (tally.probability, tally.safe))
    axes.plot(mean, share, "o-", color=_COLOURS[True], label="found; numbers: footprints")
    for place, (x, y, own) in enumerate(zip(mean, share, owns, strict=True)):
        up = 6 if place % 2 == 0 else -13
        axes.annotate(str(own.sum()), (x, y), (0, up), fontsize=8, ha="center", textcoords="offset points")
    axes.set(
        xlim=(-0.06, 1.06), ylim=(-0.14, 1.14), xlabel="safe probability stated", ylabel="share that is safe",
    )  # fmt: skip
    axes.set_title("Reliability of the safe probability", loc="left", pad=20)
    axes.legend(**_ABOVE)
