"""Plots of ground: a generated ground with its statistics, and a survey of a site."""

from __future__ import annotations

from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.ground_survey import FlightFootprint, GroundSurvey
from lidar_emu.report.oblique_view import on_ground
from lidar_emu.report.plot_style import (
    FAULT_COLOUR,
    FINE_DPI,
    GRID,
    INK,
    PATH_COLOUR,
    check_plot_path,
    number_log_axis,
    styled,
    titled_figure,
    write_plot,
)
from lidar_emu.scenario.ground import Generated, diameter_range_m
from lidar_emu.scene.procedural.compare import StatisticCheck, expected_number
from lidar_emu.scene.procedural.generate import Layers, doubling_lags, structure_function
from lidar_emu.scene.procedural.populations import Population
from lidar_emu.scene.ray_reach import Rectangle

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure


_SIZE_INCH = (10.0, 8.8)
_SPECIFIED: dict[str, Any] = {"color": INK, "linewidth": 1.2, "linestyle": "--"}


@styled
def plot_ground(
    ground: Generated, layers: Layers, comparisons: list[StatisticCheck], title: str, path: Path
) -> None:
    """Plot a ground as a PNG of 1600 by 1408 pixels.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    figure = titled_figure(title, _SIZE_INCH, 12, FINE_DPI)
    elevation_m = layers.elevation_m(ground).astype(np.float64)
    panels = figure.subplot_mosaic(
        [["shade", "structure"], ["shade", "craters"], ["shade", "rocks"], ["table", "table"]],
        width_ratios=(1.25, 1.0),
        height_ratios=(1.0, 1.0, 1.0, 1.5),
    )
    _add_shade(panels["shade"], ground, elevation_m)
    _add_table(panels["table"], comparisons)
    _add_structure(panels["structure"], ground, elevation_m, layers.relief_m)
    for name, field in (("craters", layers.craters), ("rocks", layers.rocks)):
        axes = panels[name]
        if field is None:
            axes.text(0.5, 0.5, f"no {name}", ha="center", va="center", transform=axes.transAxes)
            axes.set_axis_off()
        else:
            _add_numbers(axes, ground, name, field.population)
            _plain_ticks(axes.xaxis, axes.yaxis)
    write_plot(figure, path)


def _add_shade(axes: Axes, ground: Generated, elevation_m: FloatArray) -> None:
    along_m = np.linspace(-ground.size_m / 2, ground.size_m / 2, len(elevation_m))
    survey = GroundSurvey("", along_m, along_m, elevation_m[::-1], None)
    draw_map(axes, survey, survey.shade, cmap="gray", vmin=0.0, vmax=1.0)
    low_m, high_m = elevation_m.min(), elevation_m.max()
    heights = f"{low_m:.1f} to {high_m:.1f} m".replace("-", "−")
    axes.set_title(f"Sun in the north-west; heights {heights}", loc="left")
    axes.locator_params(nbins=5)


def _add_structure(
    axes: Axes, ground: Generated, elevation_m: FloatArray, relief_m: FloatArray | None
) -> None:
    lags = doubling_lags(len(elevation_m), 0.25)
    distance_m = lags * ground.spacing_m
    whole_m = np.sqrt(structure_function(elevation_m, lags))
    axes.loglog(distance_m, whole_m, "o-", color="C0", label="whole ground")
    if ground.relief is not None and relief_m is not None:
        alone_m = np.sqrt(structure_function(relief_m, lags))
        axes.loglog(distance_m, alone_m, "s", color="C1", label="relief alone")
        baseline_m, slope = ground.relief.baseline_m, np.tan(np.radians(ground.relief.rms_slope_deg))
        specified_m = slope * baseline_m * (distance_m / baseline_m) ** ground.relief.hurst
        axes.loglog(distance_m, specified_m, label="specified relief", **_SPECIFIED)
    axes.set(xlabel="distance (m)", ylabel="rms difference (m)")
    axes.set_title("Difference of heights over a distance", loc="left")
    axes.legend(loc="upper left", fontsize=8)
    _plain_ticks(axes.xaxis, axes.yaxis)


def _add_numbers(axes: Axes, ground: Generated, name: str, population: Population) -> None:
    smallest_m, largest_m = diameter_range_m(ground, name)
    own_m = np.sort(population.diameter_m[population.within(ground.size_m)])[::-1]
    diameter_m = np.geomspace(smallest_m, largest_m, 200)[:-1]
    axes.step(own_m, np.arange(1, len(own_m) + 1), where="post", color="C0", label="generated")
    specified = expected_number(ground, name, diameter_m)
    axes.plot(diameter_m, specified, label="specified", **_SPECIFIED)
    low, high = np.maximum(np.sqrt(specified) - 2.0, 0.0) ** 2, (np.sqrt(specified) + 2.0) ** 2
    axes.fill_between(diameter_m, np.maximum(low, 1e-3), high, color=GRID, alpha=0.3, linewidth=0,
                      label="±4σ of chance (Poisson):\n1 ground in 10 000 leaves it")  # fmt: skip
    axes.set(xscale="log", yscale="log", ylim=(0.5, 3.0 * max(len(own_m), specified.max(), 1.0)))
    axes.set(xlabel="diameter D (m)", ylabel="number")
    axes.set_title(f"{name.capitalize()} larger than D", loc="left")
    axes.legend(loc="lower left", fontsize=8)


def _plain_ticks(*log_axes: Axis) -> None:
    """Label logarithmic axes by plain numbers, also between powers of ten where these are few."""
    for axis in log_axes:
        low, high = axis.get_view_interval()
        if high > 100.0 * low:
            number_log_axis(axis, (1.0,))
        else:
            number_log_axis(axis)


def _add_table(axes: Axes, comparisons: list[StatisticCheck]) -> None:
    axes.set_axis_off()
    axes.set(xlim=(0.0, 1.0), ylim=(len(comparisons) + 1, 0.0))
    lines = [("statistic", "specified", "generated", "tolerance", INK)]
    for row in comparisons:
        tolerance = f"{row.low:.4g} to {row.high:.4g}" + ("" if row.within else ": outside")
        colour = INK if row.within else FAULT_COLOUR
        lines.append((row.quantity, f"{row.asked:.4g}", f"{row.found:.4g}", tolerance, colour))
    for line, (*cells, colour) in enumerate(lines):
        axes.axhline(line + 1.0, color=GRID, linewidth=1.0 if line == 0 else 0.4)
        for x, cell in zip((0.0, 0.62, 0.76, 1.0), cells, strict=True):
            side = "left" if x == 0.0 else "right"
            axes.text(x, line + 0.55, cell, ha=side, va="center", fontsize=8, color=colour)


_SURVEY_INCH = (10.0, 8.8)
_LETTERS_ACROSS = 125
"""Letters of a line of the description."""
_SEEN_PATH = 0.02
"""Length of the shortest path that is drawn, as a share of the map."""


@styled
def plot_survey(whole: GroundSurvey, flown: GroundSurvey | None, title: str, path: Path) -> None:
    """Plot the survey of a ground as a PNG of 1600 by 1408 pixels.

    Args:
        whole: the whole ground.
        flown: the ground below the flight; None: the flight is not known before the run.
        title: title of the figure.
        path: file, `.png`, `.svg` or `.pdf`.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    description = fill(whole.description, _LETTERS_ACROSS).replace(" -", " −")
    figure = titled_figure(f"{title}\n{description}", _SURVEY_INCH, 10, FINE_DPI)
    (relief, slope), (below, shares) = figure.subplots(2, 2)
    _draw_relief(figure, relief, whole, "Shaded relief")
    _draw_slope(figure, slope, whole)
    for axes in (relief, slope):
        if whole.footprint is not None:
            _outline(axes, whole.footprint.area)
    if flown is not None and flown.footprint is not None:
        _draw_relief(figure, below, flown, "Below the flight")
        _draw_footprint(below, flown.footprint)
    else:
        below.text(0.5, 0.5, "the flight is not known before the run", ha="center", transform=below.transAxes)
        below.set_axis_off()
    _draw_shares(shares, whole, flown)
    for axes in (relief, slope, below):
        axes.locator_params(nbins=5)
    named = [axes.get_legend_handles_labels() for axes in (relief, below)]
    figure.legend(*map(sum, zip(*named, strict=True), ([], [])), loc="outside lower center", ncols=4)
    write_plot(figure, path)


def _draw_relief(figure: Figure, axes: Axes, survey: GroundSurvey, title: str) -> None:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    low_m, high_m = _limits(survey.up_m)
    # Mixed with white, so that the shading shows in low places as well.
    mixed = ListedColormap(0.35 + 0.65 * colormaps["viridis"](np.linspace(0.0, 1.0, 256))[:, :3])
    heights = ScalarMappable(Normalize(low_m, high_m), mixed)
    colours = heights.to_rgba(np.nan_to_num(survey.up_m, nan=low_m))
    # Slopes are missing beside holes and edges of a mesh, where heights exist.
    colours[..., :3] *= (0.25 + 0.75 * np.nan_to_num(survey.shade, nan=0.6))[..., None]
    colours[..., 3] = np.isfinite(survey.up_m)
    draw_map(axes, survey, colours)
    figure.colorbar(heights, ax=axes, label="height above the origin (m)", fraction=0.045, pad=0.02,
                    extend=_beyond(survey.up_m, low_m, high_m))  # fmt: skip
    axes.set_title(title, loc="left")


def _draw_slope(figure: Figure, axes: Axes, survey: GroundSurvey) -> None:
    slope_deg = survey.slope_deg
    most_deg = max(_limits(slope_deg, 0.1)[1], 0.1)
    image = draw_map(axes, survey, slope_deg, cmap="magma_r", vmin=0.0, vmax=most_deg)
    figure.colorbar(image, ax=axes, label="slope (°)", fraction=0.045, pad=0.02,
                    extend=_beyond(slope_deg, 0.0, most_deg))  # fmt: skip
    axes.set_title(f"Slope over {2 * survey.step_m[0]:.3g} m", loc="left")


def draw_map(axes: Axes, survey: GroundSurvey, image: FloatArray, **keys: Any) -> Any:
    """Draw values or colours, (rows, columns), of the places of a survey; returns the image."""
    (half_east_m, half_north_m), area = (step_m / 2 for step_m in survey.step_m), survey.area
    edges = (
        area.west_m - half_east_m,
        area.east_m + half_east_m,
        area.south_m - half_north_m,
        area.north_m + half_north_m,
    )
    axes.grid(visible=False)
    axes.set(xlabel="east (m)", ylabel="north (m)")
    return axes.imshow(image, origin="lower", extent=edges, interpolation="nearest", **keys)


def _outline(axes: Axes, area: Rectangle) -> None:
    from matplotlib.patches import Rectangle as Patch

    corner = area.west_m, area.south_m
    size = area.east_m - area.west_m, area.north_m - area.south_m
    label = "footprint of the flight"
    axes.add_patch(Patch(corner, *size, fill=False, edgecolor=PATH_COLOUR, linewidth=1.8, label=label))


def _draw_footprint(axes: Axes, footprint: FlightFootprint) -> None:
    point_m = footprint.point_site_m.reshape(-1, 3)
    axes.plot(point_m[:, 0], point_m[:, 1], ".", color=INK, markersize=2.5)
    axes.plot([], [], color=INK, linewidth=2.5, label="beams on the ground")
    east_m, north_m, _ = footprint.path_site_m.T
    if max(np.ptp(east_m), np.ptp(north_m)) > _SEEN_PATH * np.ptp(axes.get_xlim()):
        axes.plot(east_m, north_m, color=PATH_COLOUR, path_effects=on_ground(3.0), label="path")
    axes.plot(east_m[-1], north_m[-1], "o", color=PATH_COLOUR, markeredgecolor="white", markersize=6,
              label="end of the path")  # fmt: skip


def _draw_shares(axes: Axes, whole: GroundSurvey, flown: GroundSurvey | None) -> None:
    surveys = {"whole ground": whole}
    if flown is not None and flown is not whole:
        surveys["below the flight"] = flown
    for name, survey in surveys.items():
        slope_deg = survey.slope_deg[np.isfinite(survey.slope_deg)]
        if not slope_deg.size:
            continue
        share = np.geomspace(1.0, 1e-5, 500)
        label = f"{name}, over {2 * survey.step_m[0]:.3g} m"
        axes.semilogy(np.quantile(slope_deg, 1.0 - share), 100.0 * share, label=label)
    axes.set(xlabel="slope (°)", ylabel="ground that is steeper (%)", ylim=(0.01, 110.0))
    axes.set_title("Distribution of slopes", loc="left")
    _plain_ticks(axes.yaxis)
    axes.set_xlim(left=0.0)
    axes.legend(loc="upper right")


def _beyond(values: FloatArray, low: float, high: float) -> Literal["neither", "min", "max", "both"]:
    """Ends of a colour bar that need an arrow."""
    if np.nanmin(values, initial=low) < low:
        return "both" if np.nanmax(values, initial=high) > high else "min"
    return "max" if np.nanmax(values, initial=high) > high else "neither"


def _limits(values: FloatArray, left_out_percent: float = 0.5) -> tuple[float, float]:
    """Range of almost all values, so that a spike does not take all colours."""
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0, 1.0
    low, high = np.percentile(known, [left_out_percent, 100.0 - left_out_percent]).tolist()
    return (low, high) if high - low > 1e-6 else (low - 0.5, high + 0.5)
