"""Figures 2 to 5 of Budge et al., drawn again from the shipped scenarios."""

from __future__ import annotations

from pathlib import Path

from lidar_emu.report.descent_plot import check_plot_path, plot_descent
from lidar_emu.scenario.load import load
from lidar_emu.scenario.required import require_flight
from lidar_emu.shots import FlightModel, measure_whole


def plot_paper_figure(figure: str, path: Path) -> None:
    """Fly the scenario of figure `2`, `3`, `4` or `5`, and draw it as a PNG.

    Raises:
        InputError: as `check_plot_path`.
        RunError: writing failed on the way.
    """
    check_plot_path(path)
    model = FlightModel(require_flight(load(f"paper_fig{figure}")))
    measurement = measure_whole(model)
    title = f"After figure {figure} of Budge et al.: {model.scenario.name}"
    if figure != "2":
        plot_descent(measurement, model.flight.scene, title, path)
        return
    from lidar_emu.report.paper_echoes import find_two_targets
    from lidar_emu.report.paper_scan import plot_scan

    plot_scan(measurement, find_two_targets(model), title, path)
