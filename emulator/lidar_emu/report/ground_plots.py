"""Plots of ground: a generated ground with its statistics, and a survey of a site."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.ground_survey import FlightFootprint, GroundSurvey
from lidar_emu.report.plot_style import (
    check_plot_path,
    legend_above,
    legend_beside,
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
    from matplotlib.figure import Figure


_SIZE_INCH = (16.0, 11.0)
_SUN_ELEVATION_DEG = 15.0
_SPECIFIED: dict[str, Any] = {"color": "0.35", "linewidth": 1.2, "linestyle": "--"}


@styled
def plot_ground(
    ground: Generated, layers: Layers, comparisons: list[StatisticCheck], title: str, path: Path
) -> None:
    """Plot a ground as a PNG of 1600 by 1100 pixels.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    figure = titled_figure(title, _SIZE_INCH, 17, title_at=0.975)
    elevation_m = layers.elevation_m(ground).astype(np.float64)
    _add_shade(figure.add_axes((0.06, 0.26, 0.46, 0.67)), ground, elevation_m)
    _add_table(figure.add_axes((0.06, 0.01, 0.9, 0.18)), comparisons)
    structure = figure.add_axes((0.58, 0.715, 0.29, 0.215))
    _add_structure(structure, ground, elevation_m, layers.relief_m)
    for name, bottom, field in (("craters", 0.485, layers.craters), ("rocks", 0.255, layers.rocks)):
        axes = figure.add_axes((0.58, bottom, 0.29, 0.17))
        if field is None:
            axes.text(0.5, 0.5, f"no {name}", ha="center", va="center", transform=axes.transAxes)
            axes.set_axis_off()
        else:
            _add_numbers(axes, ground, name, field.population)
    write_plot(figure, path)


def _add_shade(axes: Axes, ground: Generated, elevation_m: FloatArray) -> None:
    """Draw the ground as a Lambertian surface under a low sun in the north-west, without cast shadows."""
    south, east = np.gradient(elevation_m, ground.spacing_m)
    sun = np.radians(_SUN_ELEVATION_DEG)
    toward = np.cos(sun) * np.sqrt(0.5) * (east + south) + np.sin(sun)
    light = np.maximum(toward, 0.0) / np.sqrt(1.0 + east**2 + south**2)
    half_m = (ground.size_m + ground.spacing_m) / 2
    axes.imshow(
        light, cmap="gray", vmin=0.0, vmax=2.2 * np.sin(sun), extent=(-half_m, half_m, -half_m, half_m)
    )
    axes.grid(visible=False)
    axes.set(xlabel="east (m)", ylabel="north (m)")
    low_m, high_m = elevation_m.min(), elevation_m.max()
    axes.set_title(
        f"Sun at {_SUN_ELEVATION_DEG:g}° elevation in the north-west; heights {low_m:.1f} to {high_m:.1f} m",
        fontsize=10,
    )


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
    axes.set(xlabel="distance (m)", ylabel="rms difference\nof height (m)")
    legend_beside(axes)


def _add_numbers(axes: Axes, ground: Generated, name: str, population: Population) -> None:
    smallest_m, largest_m = diameter_range_m(ground, name)
    own_m = np.sort(population.diameter_m[population.within(ground.size_m)])[::-1]
    diameter_m = np.geomspace(smallest_m, largest_m, 200)[:-1]
    axes.step(own_m, np.arange(1, len(own_m) + 1), where="post", color="C0", label="generated")
    specified = expected_number(ground, name, diameter_m)
    axes.plot(diameter_m, specified, label="specified", **_SPECIFIED)
    low, high = np.maximum(np.sqrt(specified) - 2.0, 0.0) ** 2, (np.sqrt(specified) + 2.0) ** 2
    axes.fill_between(diameter_m, np.maximum(low, 1e-3), high, color="0.9", label="Poisson, 4 sigma")
    axes.set(xscale="log", yscale="log", ylim=(0.5, 3.0 * max(len(own_m), specified.max(), 1.0)))
    axes.set(xlabel="diameter D (m)", ylabel=f"{name} larger than D")
    legend_beside(axes)


def _add_table(axes: Axes, comparisons: list[StatisticCheck]) -> None:
    axes.set_axis_off()
    lines = [
        f"{row.quantity}: specified {row.asked:.4g}, generated {row.found:.4g}, "
        f"tolerance {row.low:.4g} to {row.high:.4g}" + ("" if row.within else " (outside)")
        for row in comparisons
    ]
    half = (len(lines) + 1) // 2
    for x, column in ((0.0, lines[:half]), (0.52, lines[half:])):
        axes.text(x, 0.95, "\n".join(column), va="top", fontsize=9, transform=axes.transAxes)


_SURVEY_INCH = (16.0, 13.0)
_SUN_DEG = 45.0
"""Elevation of the sun, in the north-west, for grounds as steep as `_STEEP`; lower for flatter ones."""
_STEEP = 0.5
_PATH_COLOUR = "#b22222"


@styled
def plot_survey(whole: GroundSurvey, flown: GroundSurvey | None, title: str, path: Path) -> None:
    """Plot the survey of a ground as a PNG of 1280 by 1040 pixels.

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
    figure = titled_figure(title, _SURVEY_INCH, 16, title_at=0.98, dpi=80)
    figure.text(0.5, 0.95, whole.description, ha="center", va="top", fontsize=10, wrap=True)
    (relief, slope), (below, shares) = figure.subplots(
        2,
        2,
        gridspec_kw={"left": 0.06, "right": 0.95, "top": 0.89, "bottom": 0.06, "hspace": 0.24, "wspace": 0.3},
    )
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
    write_plot(figure, path)


def _draw_relief(figure: Figure, axes: Axes, survey: GroundSurvey, title: str) -> None:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    low_m, high_m = _limits(survey.up_m)
    heights = ScalarMappable(Normalize(low_m, high_m), colormaps["viridis"])
    # Mixed with white, so that the shading shows in low places as well.
    colours = 0.35 + 0.65 * heights.to_rgba(np.nan_to_num(survey.up_m, nan=low_m))[..., :3]
    # Gradients are missing beside holes and edges of a mesh, where heights exist.
    shade = np.nan_to_num(light(*survey.rise), nan=0.7)
    colours *= (0.25 + 0.75 * shade)[..., None]
    colours[np.isnan(survey.up_m)] = 1.0
    draw_map(axes, survey, np.clip(colours, 0.0, 1.0))
    figure.colorbar(
        heights, ax=axes, alpha=0.65, label="height above the origin (m)", fraction=0.045, pad=0.02
    )
    axes.set_title(title, fontsize=12, loc="left")


def light(east: FloatArray, north: FloatArray) -> FloatArray:
    """Brightness (rows, columns), 0 to 1, of a matt surface with the given slopes."""
    known = np.hypot(east, north)[np.isfinite(east + north)]
    steep = max(float(np.percentile(known, 95.0)) if known.size else 0.0, 1e-3)
    exaggerated = min(_STEEP / steep, 1e3)
    east, north, sun = east * exaggerated, north * exaggerated, np.radians(_SUN_DEG)
    toward = np.cos(sun) * np.sqrt(0.5) * (east - north) + np.sin(sun)
    return np.asarray(np.clip(toward / np.sqrt(1.0 + east**2 + north**2), 0.0, 1.0))


def _draw_slope(figure: Figure, axes: Axes, survey: GroundSurvey) -> None:
    slope_deg = survey.slope_deg
    _, most_deg = _limits(slope_deg)
    image = draw_map(axes, survey, slope_deg, cmap="magma_r", vmin=0.0, vmax=max(most_deg, 0.1))
    figure.colorbar(image, ax=axes, label="slope (°)", fraction=0.045, pad=0.02, extend="max")
    axes.set_title(f"Slope over {2 * survey.step_m[0]:.3g} m", fontsize=12, loc="left")


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
    axes.add_patch(Patch(corner, *size, fill=False, edgecolor=_PATH_COLOUR, linewidth=1.5, label=label))
    legend_above(axes, columns=3)


def _draw_footprint(axes: Axes, footprint: FlightFootprint) -> None:
    point_m = footprint.point_site_m.reshape(-1, 3)
    axes.plot(point_m[:, 0], point_m[:, 1], ".", color="black", markersize=1.0, label="beams on the ground")
    east_m, north_m, _ = footprint.path_site_m.T
    axes.plot(east_m, north_m, color=_PATH_COLOUR, linewidth=1.5, label="path")
    axes.plot(east_m[-1], north_m[-1], "o", color=_PATH_COLOUR, markersize=5, label="end")
    legend_above(axes, columns=3)


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
    axes.set(xlabel="slope (°)", ylabel="share of the ground that is steeper (%)", ylim=(0.01, 110.0))
    axes.set_xlim(left=0.0)
    legend_above(axes, columns=1)


def _limits(values: FloatArray) -> tuple[float, float]:
    """Range of almost all values, so that a spike does not take all colours."""
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0, 1.0
    low, high = np.percentile(known, [0.5, 99.5]).tolist()
    return (low, high) if high - low > 1e-6 else (low - 0.5, high + 0.5)
