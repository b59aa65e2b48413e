"""Plot of a generated ground: shaded relief, and its statistics beside the specified ones."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.legends import legend_beside
from lidar_emu.report.png_file import check_plot_path, write_png
from lidar_emu.scenario.generated_ground import Generated, diameter_range_m
from lidar_emu.scene.generated.compare import StatisticCheck, expected_number
from lidar_emu.scene.generated.generate import Layers
from lidar_emu.scene.generated.population import Population
from lidar_emu.scene.generated.statistics import doubling_lags, structure_function

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SIZE_INCH = (16.0, 11.0)
_DOTS_PER_INCH = 100
_SUN_ELEVATION_DEG = 15.0
_SPECIFIED: dict[str, Any] = {"color": "0.35", "linewidth": 1.2, "linestyle": "--"}


def plot_ground(
    ground: Generated, layers: Layers, comparisons: list[StatisticCheck], title: str, path: Path
) -> None:
    """Plot a ground as a PNG of 1600 by 1100 pixels.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_INCH, dpi=_DOTS_PER_INCH)
    figure.suptitle(title, x=0.5, y=0.975, fontsize=17)
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
    write_png(figure, path)


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
    axes.set(xlabel="east (m)", ylabel="north (m)")
    low_m, high_m = elevation_m.min(), elevation_m.max()
    axes.set_title(
        f"sun at {_SUN_ELEVATION_DEG:g}° elevation in the north-west; heights {low_m:.1f} to {high_m:.1f} m",
        fontsize=10,
    )


def _add_structure(
    axes: Axes, ground: Generated, elevation_m: FloatArray, relief_m: FloatArray | None
) -> None:
    lags = doubling_lags(len(elevation_m), 0.25)
    distance_m = lags * ground.spacing_m
    axes.loglog(
        distance_m, np.sqrt(structure_function(elevation_m, lags)), "o-", color="C0", label="whole ground"
    )
    if ground.relief is not None and relief_m is not None:
        axes.loglog(
            distance_m, np.sqrt(structure_function(relief_m, lags)), "s", color="C1", label="relief alone"
        )
        baseline_m, slope = ground.relief.baseline_m, np.tan(np.radians(ground.relief.rms_slope_deg))
        specified_m = slope * baseline_m * (distance_m / baseline_m) ** ground.relief.hurst
        axes.loglog(distance_m, specified_m, label="specified relief", **_SPECIFIED)
    axes.set(xlabel="distance (m)", ylabel="rms difference\nof height (m)")
    axes.grid(color="0.92")
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
    axes.grid(color="0.92")
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
