"""All figures of a recording, and the reasons why others are missing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from lidar_emu.errors import Finding, InputError
from lidar_emu.plan.plan import Plan
from lidar_emu.report import flight_figures, run_figures
from lidar_emu.report.motion_figure import draw_motion
from lidar_emu.report.page_style import Drawing
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.report.spectra import NoSpectraError, choose_measurements, compute_spectra, draw_spectra
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import Model, build_model


class Figures:
    """Every figure that a recording permits, drawn one after the other: a long recording's take 50 MB each.

    Args:
        run: the recording.
        at_s: scenario times at which spectra are computed; empty: the first valid measurement, a middle and the last.
    """

    def __init__(self, run: RecordedRun, at_s: Sequence[float]) -> None:
        self._run = run
        self._at_s = at_s
        self.notes: list[str] = []
        """Figures that are missing, with the reasons, as far as has been drawn."""
        self._model = self._build_model()
        self.plan: Plan | None = None if self._model is None else self._model.plan
        """Plan of the run; None if its model cannot be built here."""

    def __iter__(self) -> Iterator[Drawing]:
        run, measured = self._run, self._run.measurement
        flight = self._model if isinstance(self._model, FlightModel) else None
        if run.is_flight:
            scene = None if flight is None else flight.flight.scene
            yield flight_figures.draw_path(measured, scene)
            yield draw_motion(measured, scene)
        if measured.range_valid.any() or measured.speed_valid.any():
            yield flight_figures.draw_truth(measured)
            yield flight_figures.draw_errors(measured)
        else:
            self.notes.append("No ranges, speeds and errors: no measurement is valid.")
        yield run_figures.draw_signal(measured)
        yield run_figures.draw_validity(measured)
        yield from self._permitted(run_figures.draw_timeline(run))
        if run.is_flight:
            yield from self._permitted(self._spectra(flight))
        else:
            self.notes.append("No path and spectra: a bench pattern has no position and no receiver.")
        yield from self._permitted(run_figures.draw_lateness(run))
        if not run.keeps_time:
            self.notes.append(
                f"No lateness: at pace {run.recording.origin['pace']} packets have no deadline."
            )

    @staticmethod
    def _permitted(drawing: Drawing | None) -> list[Drawing]:
        return [] if drawing is None else [drawing]

    def _build_model(self) -> Model | None:
        try:
            return build_model(self._run.recording.scenario)
        except InputError as error:
            self.notes.append(f"No ground, plan and spectra: the scenario cannot be built here ({error}).")
            return None

    def _spectra(self, model: FlightModel | None) -> Drawing | None:
        if model is None:
            return None
        if model.scenario.live is not None:
            self.notes.append("No spectra: they are not recomputed from live truth.")
            return None
        measured = self._run.measurement
        try:
            places = choose_measurements(measured, self._at_s)
            return (
                draw_spectra([compute_spectra(model, measured, *place) for place in places])
                if places
                else None
            )
        except NoSpectraError as error:
            self.notes.append(f"No spectra: {error}.")
            return None


def check_instants(run: RecordedRun, at_s: Sequence[float]) -> None:
    """Refuse times outside the recording.

    Raises:
        InputError: names the first time outside.
    """
    first_s, last_s = (float(f()) * 1e-9 for f in (run.measurement.time_ns.min, run.measurement.time_ns.max))
    for instant_s in at_s:
        if not first_s - 1.0 <= instant_s <= last_s + 1.0:
            remedy = f"must be within the recording, {first_s:.3f} s to {last_s:.3f} s"
            raise InputError("--spectra-at", None, Finding(f"{instant_s:g} s"), remedy)
