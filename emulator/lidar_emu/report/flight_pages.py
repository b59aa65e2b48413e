"""Which figures a recording gives, and why others are missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from lidar_emu.errors import Finding, InputError
from lidar_emu.plan.plan import Plan
from lidar_emu.report import flight_figures, run_figures
from lidar_emu.report.page_style import Drawing
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.report.spectra import CannotHearError, choose, draw_spectra, listen
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import Model, build_model


class Figures(NamedTuple):
    """What there is to see."""

    drawings: list[Drawing]
    notes: list[str]
    """What is not shown, and why."""
    plan: Plan | None
    """What the run computed; None where its model cannot be built here."""


def draw_all(flown: RecordedRun, at_s: Sequence[float]) -> Figures:
    """Every figure that the recording gives.

    Args:
        flown: the recording.
        at_s: scenario times whose spectra are wanted; none: the first, one in the middle, the last.
    """
    notes: list[str] = []
    model = _model(flown, notes)
    measured, flight = flown.measurement, model if isinstance(model, FlightModel) else None
    drawings = [run_figures.validity(measured), run_figures.timeline(flown)]
    if measured.range_valid.any() or measured.speed_valid.any():
        drawings[:0] = [flight_figures.against_truth(measured), flight_figures.errors(measured)]
    else:
        notes.append("Without ranges, speeds and errors: no measurement is valid.")
    if flown.is_flight:
        drawings.insert(0, flight_figures.where(measured, None if flight is None else flight.flight.scene))
        drawings.append(_spectra(flown, flight, at_s, notes))
    else:
        notes.append("Without path and spectra: a bench pattern knows of no place and computes no receiver.")
    drawings.append(run_figures.lateness(flown))
    if not flown.keeps_time:
        notes.append(
            f"Without lateness: at pace {flown.recording.origin['pace']} packets have no instant to keep."
        )
    return Figures([d for d in drawings if d is not None], notes, None if model is None else model.plan)


def _model(flown: RecordedRun, notes: list[str]) -> Model | None:
    """The model as it was, where files that the scenario names are still there."""
    try:
        return build_model(flown.recording.scenario)
    except InputError as error:
        notes.append(f"Without ground, plan and spectra: the scenario cannot be built here ({error}).")
        return None


def _spectra(
    flown: RecordedRun, model: FlightModel | None, at_s: Sequence[float], notes: list[str]
) -> Drawing | None:
    if model is None:
        return None
    if model.scenario.live is not None:
        notes.append("Without spectra: live truth is not flown again for them.")
        return None
    try:
        places = choose(flown.measurement, at_s)
        return (
            draw_spectra([listen(model, flown.measurement, *place) for place in places]) if places else None
        )
    except CannotHearError as error:
        notes.append(f"Without spectra: {error}.")
        return None


def check_instants(flown: RecordedRun, at_s: Sequence[float]) -> None:
    """Refuse instants that are none of the recording.

    Raises:
        InputError: one lies outside.
    """
    first_s, last_s = (
        float(f()) * 1e-9 for f in (flown.measurement.time_ns.min, flown.measurement.time_ns.max)
    )
    for instant_s in at_s:
        if not first_s - 1.0 <= instant_s <= last_s + 1.0:
            allowed = f"allowed: {first_s:.3f} to {last_s:.3f}, the recording"
            raise InputError("--spectra-at", None, Finding(f"{instant_s:g} s"), allowed)
