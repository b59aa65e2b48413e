"""The figure of a hazard map: ground and hazards, points, safe probability, and how far to trust them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import uniform_filter

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.beam_colours import beam_colour
from lidar_emu.report.ground_plots import draw_map
from lidar_emu.report.ground_survey import GroundSurvey
from lidar_emu.report.hazard_map import HazardMap
from lidar_emu.report.hazard_regions import DetectionTally, TrueHazard, by_height
from lidar_emu.report.hazards import CELL_M, Cloud
from lidar_emu.report.plot_style import titled_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

_SIZE_INCH = (19.0, 11.5)
_COLOURS = {True: "#0057b8", False: "black"}
"""Colours of hazards that are detected, and missed."""
_FEW_POINTS = 8000
_RELIABILITY = np.array([0.0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98, 1.0 + 1e-9])


def draw_hazards(
    cloud: Cloud,
    found: HazardMap,
    truth: GroundSurvey,
    flown: DetectionTally,
    tally: DetectionTally,
    title: str,
) -> Figure:
    """Draw a figure of 1900 by 1150 dots.

    Args:
        cloud: points of a flight.
        found: the flight's map.
        truth: the ground of the map.
        flown: hazards of the flight.
        tally: counts of all flights.
        title: title of the figure.
    """
    figure = titled_figure(title, _SIZE_INCH, 17)
    parts: Any = figure.subfigures(2, 1, height_ratios=(1.55, 1.0))
    above, below = parts
    ground, points, safe = above.subplots(1, 3, sharey=True)
    detection, reliability = below.subplots(1, 2)
    hazards = [hazard for hazard in flown.hazards if abs(hazard.height_m) >= found.lander.step_m]
    _draw_ground(above, ground, truth, found)
    _draw_points(points, truth, cloud)
    for axes in (ground, points):
        _draw_hazard_symbols(axes, hazards)
    _draw_safe(above, safe, found)
    for axes in (ground, points, safe):
        area = truth.area
        axes.set(xlim=(area.west_m, area.east_m), ylim=(area.south_m, area.north_m))
        axes.set_anchor("N")
        axes.label_outer()
        _scale_bar(axes, area.east_m - area.west_m)
    _name_symbols(above, hazards, cloud, found)
    _draw_detection(detection, tally, found.lander.step_m)
    _draw_reliability(reliability, tally)
    return figure


def _draw_ground(figure: SubFigure, axes: Axes, truth: GroundSurvey, found: HazardMap) -> None:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    slopes = ScalarMappable(Normalize(0.0, 2 * found.lander.slope_deg), colormaps["YlOrBr"])
    colours = slopes.to_rgba(np.nan_to_num(truth.slope_deg))[..., :3] * _shade(truth)[..., None]
    colours[np.isnan(truth.up_m)] = 1.0
    draw_map(axes, truth, np.clip(colours, 0.0, 1.0))
    bar = figure.colorbar(
        slopes, ax=axes, label="slope (°), true", location="bottom", shrink=0.8, extend="max"
    )
    bar.ax.axvline(found.lander.slope_deg, color="black")
    axes.set_title("ground with its hazards")


def _shade(truth: GroundSurvey) -> FloatArray:
    return np.asarray(0.3 + 0.7 * np.nan_to_num(truth.shade, nan=0.6))


def _draw_points(axes: Axes, truth: GroundSurvey, cloud: Cloud) -> None:
    draw_map(axes, truth, _shade(truth), cmap="gray", vmin=0.0, vmax=1.0)
    size = 5.0 if len(cloud.seen_m) < _FEW_POINTS else 2.6
    for beam in np.unique(cloud.seen_beam):
        own_m = cloud.seen_m[cloud.seen_beam == beam]
        axes.plot(
            own_m[:, 0], own_m[:, 1], ".", color=beam_colour(int(beam)), markersize=size, markeredgewidth=0.0,
            rasterized=True,
        )  # fmt: skip
    axes.set_title(f"points measured ({len(cloud.seen_m)})")


def _draw_hazard_symbols(axes: Axes, hazards: list[TrueHazard]) -> None:
    for hazard in hazards:
        colour = _COLOURS[hazard.detected]
        axes.add_patch(
            _symbol(
                hazard.kind, (hazard.east_m, hazard.north_m), hazard.length_m, hazard.width_m,
                float(np.degrees(hazard.azimuth_rad)), edgecolor=colour, linewidth=1.4,
                linestyle="-" if hazard.detected else (0, (2, 1)), path_effects=[_stroke("white")],
            )
        )  # fmt: skip


def _stroke(colour: str) -> Any:
    from matplotlib.patheffects import withStroke

    return withStroke(linewidth=3.2, foreground=colour)


def _symbol(
    kind: str, place: tuple[float, float], length: float, width: float, angle: float, **how: Any
) -> Any:
    """An ellipse for a boulder, with a cross for a crater; a rectangle for a step."""
    from matplotlib.patches import Ellipse, Rectangle

    if kind == "step":
        corner = place[0] - length / 2, place[1] - width / 2
        return Rectangle(corner, length, width, angle=angle, rotation_point="center", fill=False, **how)
    hatch = {"hatch": "x"} if kind == "crater" else {}
    return Ellipse(place, length, width, angle=angle, fill=False, **hatch, **how)


def _draw_safe(figure: SubFigure, axes: Axes, found: HazardMap) -> None:
    from matplotlib.patches import Circle

    survey = GroundSurvey("", found.east_m, found.north_m, found.height_m, None)
    axes.set_facecolor("0.85")
    image = draw_map(axes, survey, found.safe_probability, cmap="cividis", vmin=0.0, vmax=1.0)
    figure.colorbar(image, ax=axes, label="safe probability", location="bottom", shrink=0.8)
    lander = found.lander
    axes.set_title(
        f"safe to land: slope < {lander.slope_deg:g}°, step < {lander.step_m:g} m over {lander.footprint_m:g} m"
    )
    if np.isfinite(found.safe_probability).any():
        place, _ = _safest(found)
        how: Any = {"path_effects": [_stroke("black")]}
        axes.add_patch(
            Circle(place, lander.footprint_m / 2, fill=False, edgecolor="white", linewidth=2.0, **how)
        )
        axes.plot(*place, "+", color="white", markersize=10, **how)


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
    axes.plot([start_m, start_m + length_m], [0.04, 0.04], color="white", linewidth=7, transform=transform)
    axes.plot([start_m, start_m + length_m], [0.04, 0.04], color="black", linewidth=3, transform=transform)
    axes.text(
        start_m + length_m / 2, 0.055, f"{length_m:g} m", ha="center", va="bottom", transform=transform,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
    )  # fmt: skip


def _name_symbols(figure: SubFigure, hazards: list[TrueHazard], cloud: Cloud, found: HazardMap) -> None:
    from matplotlib.legend_handler import HandlerPatch
    from matplotlib.lines import Line2D
    from matplotlib.patches import Ellipse

    def small_ellipse(*, xdescent: float, ydescent: float, width: float, height: float, **_: Any) -> Ellipse:
        return Ellipse((width / 2 - xdescent, height / 2 - ydescent), 1.8 * height, 1.2 * height)

    names = {"boulder": "boulder, rim", "crater": "crater", "step": "step"}
    kinds = [(kind, is_found) for kind in names for is_found in (True, False)]
    counts = {key: sum((hazard.kind, hazard.detected) == key for hazard in hazards) for key in kinds}
    handles = [
        _symbol(kind, (0, 0), 1, 1, 0, edgecolor=_COLOURS[is_found], linestyle="-" if is_found else (0, (2, 1)),
                label=f"{names[kind]}, {'detected' if is_found else 'missed'} ({counts[kind, is_found]})")
        for kind, is_found in kinds
    ]  # fmt: skip
    handles += [
        Line2D(
            [], [], marker=".", linestyle="", color=beam_colour(int(beam)), label=f"beam {beam}", markersize=9
        )
        for beam in np.unique(cloud.seen_beam)[:8]
    ]
    if np.isfinite(found.safe_probability).any():
        best = _safest(found)[1]
        ring = Line2D([], [], marker="o", linestyle="", markerfacecolor="0.5", markeredgecolor="white",
                      markersize=12, label=f"lander where it is safest\n(probability {best:.2f})")  # fmt: skip
        handles.append(ring)
    handles.append(
        Line2D([], [], marker="s", linestyle="", color="0.85", markersize=10, label="too few points")
    )
    figure.legend(
        handles=handles, handler_map={Ellipse: HandlerPatch(small_ellipse)}, loc="outside right upper", frameon=False,
        title=f"hazards from {found.lander.step_m:g} m up or\ndown, in true size",
    )  # fmt: skip


def _draw_detection(axes: Axes, tally: DetectionTally, step_m: float) -> None:
    rows = by_height(tally.hazards, step_m)
    known = [row for row in rows if row.hazards]
    middle_m = [np.sqrt(row.low_m * row.high_m) for row in known]
    share = np.array([row.detected / row.hazards for row in known])
    bounds = np.array([row.interval for row in known]).reshape(-1, 2).T
    axes.errorbar(
        middle_m, 100 * share, 100 * np.abs(bounds - share), fmt="o-", color=_COLOURS[True], capsize=3,
        label="detected",
    )  # fmt: skip
    touched = [100 * row.touched / row.hazards for row in known]
    axes.plot(middle_m, touched, "s:", color="0.45", label="with a point on it")
    for at_m, row in zip(middle_m, known, strict=True):
        axes.annotate(str(row.hazards), (at_m, 104), fontsize=8, ha="center", annotation_clip=False)
    low, high = tally.alarm_interval
    count = sum(row.hazards for row in rows)
    title = f"probability of detection of {count} hazards\n(above: their number; bars: 95 % intervals)"
    axes.axvline(step_m, color="black", linewidth=0.8, linestyle="--", label="step of the lander")
    axes.set(
        xscale="log", ylim=(-4, 114), xlabel="height of the hazard above or below its surroundings (m)",
        ylabel="probability (%)", title=title,
    )  # fmt: skip
    ticks = [
        tick
        for tick in (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 2.0, 3.0, 5.0, 10.0)
        if rows and rows[0].low_m < tick < rows[-1].high_m
    ]
    axes.minorticks_off()
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    share_words = (
        f"false alarms: {tally.alarms} of {tally.level} points\n({100 * low:.2g} to {100 * high:.2g} %)"
    )
    axes.plot([], [], " ", label=share_words)
    _legend(axes)


def _draw_reliability(axes: Axes, tally: DetectionTally) -> None:
    number = np.digitize(tally.probability, _RELIABILITY) - 1
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=1.0, label="as stated")
    owns = [number == k for k in np.unique(number)]
    mean, share = ([float(each[own].mean()) for own in owns] for each in (tally.probability, tally.safe))
    axes.plot(mean, share, "o-", color=_COLOURS[True], label="found, with the\nnumber of footprints")
    for x, y, own in zip(mean, share, owns, strict=True):
        axes.annotate(str(own.sum()), (x, y), (-5, 4), fontsize=8, ha="right", textcoords="offset points")
    axes.set(
        xlim=(-0.04, 1.06), ylim=(-0.04, 1.06), xlabel="safe probability stated", ylabel="share that is safe",
        title="reliability of the safe probability",
    )  # fmt: skip
    _legend(axes)


def _legend(axes: Axes) -> None:
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), frameon=False, fontsize=9)
