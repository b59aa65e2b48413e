"""Plot of a survey of the ground: shaded relief, slope, the footprint of the flight, and the distribution of slopes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.ground_survey import FlightFootprint, GroundSurvey
from lidar_emu.report.legends import legend_above
from lidar_emu.report.png_file import check_plot_path, write_png
from lidar_emu.scene.map_area import Rectangle

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIZE_INCH = (16.0, 13.0)
_DOTS_PER_INCH = 80
_SUN_DEG = 45.0
"""Elevation of the sun, in the north-west, for grounds as steep as `_STEEP`; lower for flatter ones."""
_STEEP = 0.5
_PATH_COLOUR = "#b22222"


def plot_survey(whole: GroundSurvey, flown: GroundSurvey | None, title: str, path: Path) -> None:
    """Plot the survey of a ground as a PNG of 1280 by 1040 pixels.

    Args:
        whole: the whole ground.
        flown: the ground below the flight; None: the flight is not known before the run.
        title: title of the figure.
        path: file, `.png`.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_INCH, dpi=_DOTS_PER_INCH)
    figure.suptitle(title, x=0.5, y=0.98, fontsize=16)
    figure.text(0.5, 0.95, whole.description, ha="center", va="top", fontsize=10, wrap=True)
    (relief, slope), (below, shares) = figure.subplots(
        2,
        2,
        gridspec_kw={"left": 0.06, "right": 0.95, "top": 0.89, "bottom": 0.06, "hspace": 0.24, "wspace": 0.3},
    )
    _draw_relief(figure, relief, whole, "shaded relief")
    _draw_slope(figure, slope, whole)
    for axes in (relief, slope):
        if whole.footprint is not None:
            _outline(axes, whole.footprint.area)
    if flown is not None and flown.footprint is not None:
        _draw_relief(figure, below, flown, "below the flight")
        _draw_footprint(below, flown.footprint)
    else:
        below.text(0.5, 0.5, "the flight is not known before the run", ha="center", transform=below.transAxes)
        below.set_axis_off()
    _draw_shares(shares, whole, flown)
    write_png(figure, path)


def _draw_relief(figure: Figure, axes: Axes, survey: GroundSurvey, title: str) -> None:
    """Draw heights in colours, lit by a sun in the north-west that stands the lower the flatter the ground is."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    low_m, high_m = _limits(survey.up_m)
    heights = ScalarMappable(Normalize(low_m, high_m), colormaps["viridis"])
    # Mixed with white, so that the shading shows in low places as well.
    colours = 0.35 + 0.65 * heights.to_rgba(np.nan_to_num(survey.up_m, nan=low_m))[..., :3]
    # Gradients are missing beside holes and edges of a mesh, where heights exist.
    light = np.nan_to_num(_light(*survey.rise), nan=0.7)
    colours *= (0.25 + 0.75 * light)[..., None]
    colours[np.isnan(survey.up_m)] = 1.0
    _draw_map(axes, survey, np.clip(colours, 0.0, 1.0))
    figure.colorbar(
        heights, ax=axes, alpha=0.65, label="height above the origin (m)", fraction=0.045, pad=0.02
    )
    axes.set_title(title, fontsize=12, loc="left")


def _light(east: FloatArray, north: FloatArray) -> FloatArray:
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
    image = _draw_map(axes, survey, slope_deg, cmap="magma_r", vmin=0.0, vmax=max(most_deg, 0.1))
    figure.colorbar(image, ax=axes, label="slope (°)", fraction=0.045, pad=0.02, extend="max")
    axes.set_title(f"slope over {2 * survey.step_m[0]:.3g} m", fontsize=12, loc="left")


def _draw_map(axes: Axes, survey: GroundSurvey, image: FloatArray, **keys: Any) -> Any:
    (half_east_m, half_north_m), area = (step_m / 2 for step_m in survey.step_m), survey.area
    edges = (
        area.west_m - half_east_m,
        area.east_m + half_east_m,
        area.south_m - half_north_m,
        area.north_m + half_north_m,
    )
    axes.set(xlabel="east (m)", ylabel="north (m)")
    return axes.imshow(image, origin="lower", extent=edges, interpolation="nearest", **keys)


def _outline(axes: Axes, area: Rectangle) -> None:
    from matplotlib.patches import Rectangle as Patch

    corner = area.west_m, area.south_m
    size = area.east_m - area.west_m, area.north_m - area.south_m
    axes.add_patch(
        Patch(
            corner, *size, fill=False, edgecolor=_PATH_COLOUR, linewidth=1.5, label="footprint of the flight"
        )
    )
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
    for label, survey in surveys.items():
        slope_deg = survey.slope_deg[np.isfinite(survey.slope_deg)]
        if not slope_deg.size:
            continue
        share = np.geomspace(1.0, 1e-5, 500)
        axes.semilogy(
            np.quantile(slope_deg, 1.0 - share),
            100.0 * share,
            label=f"{label}, over {2 * survey.step_m[0]:.3g} m",
        )
    axes.set(xlabel="slope (°)", ylabel="share of the ground that is steeper (%)", ylim=(0.01, 110.0))
    axes.set_xlim(left=0.0)
    axes.grid(color="0.92")
    legend_above(axes, columns=1)


def _limits(values: FloatArray) -> tuple[float, float]:
    """Range of almost all values, so that a spike does not take all colours."""
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0, 1.0
    low, high = np.percentile(known, [0.5, 99.5]).tolist()
    return (low, high) if high - low > 1e-6 else (low - 0.5, high + 0.5)
