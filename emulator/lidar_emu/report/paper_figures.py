"""Figures 2 to 5 of Budge et al., reproduced from the shipped scenarios."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from lidar_emu.measurement import Measurement
from lidar_emu.report.descent_plot import plot_descent
from lidar_emu.report.paper_echoes import find_two_targets
from lidar_emu.report.paper_scan import plot_scan
from lidar_emu.report.png_file import check_plot_path
from lidar_emu.scenario.load import load
from lidar_emu.scenario.required import require_flight
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import measure_whole


def plot_paper_figure(figure: str, path: Path) -> Measurement:
    """Fly the scenario of figure `2`, `3`, `4` or `5`, and plot it as a PNG.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    model = FlightModel(require_flight(load(f"paper_fig{figure}")))
    measurement = measure_whole(model)
    title = f"After figure {figure} of Budge et al.: {model.scenario.name}"
    if figure == "2":
        plot_scan(measurement, find_two_targets(model), title, path)
    else:
        plot_descent(measurement, model.flight.scene, title, path)
    return measurement


class Errors(NamedTuple):
    """Errors of the measurements of a flight against the ground truth along the beam axes."""

    measured: int
    fired: int
    range_mean_m: float
    range_deviation_m: float
    speed_mean_mps: float
    speed_deviation_mps: float


def errors_of(measurement: Measurement) -> Errors:
    """Compute mean and standard deviation of the errors over all beams and shots."""
    valid = measurement.range_valid & measurement.speed_valid
    range_m = (measurement.range_m - measurement.true_range_m)[valid]
    speed_mps = (measurement.closing_speed_mps - measurement.true_closing_speed_mps)[valid]
    moments = (float(value) for error in (range_m, speed_mps) for value in (error.mean(), error.std()))
    return Errors(int(valid.sum()), int(measurement.fired.sum()), *moments)
