"""All figures of a recording, and the reasons why others are missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from lidar_emu.errors import Finding, InputError
from lidar_emu.plan.plan import Plan
from lidar_emu.report import flight_figures, run_figures
from lidar_emu.report.motion_figure import draw_motion
from lidar_emu.report.page_style import Drawing
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.report.spectra import NoSpectraError, choose_measurements, compute_spectra, draw_spectra
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import Model, build_model


class Figures(NamedTuple):
    """Figures of a recording."""

    drawings: list[Drawing]
    notes: list[str]
    """Figures that are missing, with the reasons."""
    plan: Plan | None
    """Plan of the run; None if its model cannot be built here."""


def draw_figures(run: RecordedRun, at_s: Sequence[float]) -> Figures:
    """Draw every figure that the recording permits.

    Args:
        run: the recording.
        at_s: scenario times at which spectra are computed; empty: the first valid measurement, a middle and the last.
    """
    notes: list[str] = []
    model = _model(run, notes)
    measured, flight = run.measurement, model if isinstance(model, FlightModel) else None
    drawings = [
        run_figures.draw_signal(measured),
        run_figures.draw_validity(measured),
        run_figures.draw_timeline(run),
    ]
    if measured.range_valid.any() or measured.speed_valid.any():
        drawings[:0] = [flight_figures.draw_truth(measured), flight_figures.draw_errors(measured)]
    else:
        notes.append("No ranges, speeds and errors: no measurement is valid.")
    if run.is_flight:
        scene = None if flight is None else flight.flight.scene
        drawings[:0] = [flight_figures.draw_path(measured, scene), draw_motion(measured, scene)]
        drawings.append(_spectra(run, flight, at_s, notes))
    else:
        notes.append("No path and spectra: a bench pattern has no position and no receiver.")
    drawings.append(run_figures.draw_lateness(run))
    if not run.keeps_time:
        notes.append(f"No lateness: at pace {run.recording.origin['pace']} packets have no deadline.")
    return Figures([d for d in drawings if d is not None], notes, None if model is None else model.plan)


def _model(run: RecordedRun, notes: list[str]) -> Model | None:
    """Build the model of the run; None if files named by the scenario are missing."""
    try:
        return build_model(run.recording.scenario)
    except InputError as error:
        notes.append(f"No ground, plan and spectra: the scenario cannot be built here ({error}).")
        return None


def _spectra(
    run: RecordedRun, model: FlightModel | None, at_s: Sequence[float], notes: list[str]
) -> Drawing | None:
    if model is None:
        return None
    if model.scenario.live is not None:
        notes.append("No spectra: they are not recomputed from live truth.")
        return None
    try:
        places = choose_measurements(run.measurement, at_s)
        return (
            draw_spectra([compute_spectra(model, run.measurement, *place) for place in places])
            if places
            else None
        )
    except NoSpectraError as error:
        notes.append(f"No spectra: {error}.")
        return None


def check_instants(run: RecordedRun, at_s: Sequence[float]) -> None:
    """Refuse times outside the recording.

    Raises:
        InputError: names the first time outside.
    """
    first_s, last_s = (float(f()) * 1e-9 for f in (run.measurement.time_ns.min, run.measurement.time_ns.max))
    for instant_s in at_s:
        if not first_s - 1.0 <= instant_s <= last_s + 1.0:
            allowed = f"allowed: {first_s:.3f} to {last_s:.3f}, the times of the recording"
            raise InputError("--spectra-at", None, Finding(f"{instant_s:g} s"), allowed)
