"""All figures of a recording, and the reasons why others are missing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.plan import Plan
from lidar_emu.receiver.custom_detection import SegmentSpectrum
from lidar_emu.reference.level import ScattererLevel
from lidar_emu.report import flight_figures, run_figures
from lidar_emu.report.flight_figures import draw_motion
from lidar_emu.report.plot_style import Drawing, draw_figure
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import Model, build_model, state_before

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_CHOSEN = 3
_SEGMENTS = ("up-chirp", "constant", "down-chirp")
_COLUMNS = 1400
"""Plotted points per spectrum; beyond this number, the highest of several bins is plotted."""
_SAME_M = 1e-6


@dataclass(frozen=True)
class Spectra:
    """The three spectra of one beam of one shot; powers are relative to the mean noise of a bin."""

    shot: int
    beam: int
    time_s: float
    range_m: float
    """Recorded range."""
    closing_speed_mps: float
    """Recorded closing speed."""
    power: FloatArray
    """(3, N/2 + 1) Windowed power of the bins of each segment."""
    threshold: float
    """Detection threshold, relative to the mean noise of a bin."""
    bin_hz: float


class NoSpectraError(Exception):
    """The spectra of a measurement cannot be recomputed."""


def choose_measurements(measurement: Measurement, at_s: Sequence[float]) -> list[tuple[int, int]]:
    """Choose valid measurements by row and beam: nearest to these times, or by default the first, middle and last."""
    rows, beams = np.nonzero(measurement.range_valid & measurement.speed_valid)
    if not len(rows):
        return []
    time_s = measurement.time_ns[rows, beams] * 1e-9
    near = [int(np.abs(time_s - instant_s).argmin()) for instant_s in at_s]
    places = near or np.unique(np.linspace(0, len(rows) - 1, _CHOSEN).astype(np.int64)).tolist()
    return [(int(rows[place]), int(beams[place])) for place in places]


def compute_spectra(model: FlightModel, measurement: Measurement, row: int, beam: int) -> Spectra:
    """Compute the spectra of one measurement as level reference does, with other speckle and noise than the run's.

    Raises:
        NoSpectraError: the scenario alone does not determine where the beam pointed, or its spectra have no single
            record.
    """
    if model.scenario.instrument.detection.looks != 1:
        raise NoSpectraError("the instrument averages the spectra of several looks")
    scenario, shot = model.scenario, measurement.shot[row : row + 1]
    first = int(shot[0])
    pointing, _ = model.aim(shot, state_before(model, first))
    hits = model.flight.cast(pointing)
    apart_m = abs(hits.range_m[0, beam] - measurement.true_range_m[row, beam])
    if not (pointing.fired[0, beam] and apart_m <= _SAME_M * measurement.true_range_m[row, beam]):
        raise NoSpectraError(
            f"shot {first} differs from the scenario alone: commands changed the flight before it"
        )
    found: list[SegmentSpectrum] = []

    def keep(spectrum: SegmentSpectrum) -> list[float]:
        if spectrum.beam == beam:
            found.append(spectrum)
        return []

    try:
        ScattererLevel(scenario, model.flight, keep).measure(pointing, hits, shot)
    except InputError as error:
        raise NoSpectraError(str(error)) from None
    if not found:
        raise NoSpectraError(f"shot {first} touches the ground while its light travels")
    return Spectra(
        shot=first,
        beam=beam,
        time_s=float(measurement.time_ns[row, beam] * 1e-9),
        range_m=float(measurement.range_m[row, beam]),
        closing_speed_mps=float(measurement.closing_speed_mps[row, beam]),
        power=np.stack([one.power / np.maximum(one.noise_power, np.finfo(float).tiny) for one in found]),
        threshold=float(found[0].threshold[1] / found[0].noise_power[1]),
        bin_hz=scenario.instrument.waveform.bin_width_hz,
    )


def draw_spectra(spectra: list[Spectra]) -> Drawing:
    """Draw spectra, a row per measurement."""

    def plot(figure: Figure) -> None:
        for axes, one in zip(np.atleast_1d(figure.subplots(len(spectra), sharex=True)), spectra, strict=True):
            for segment, power in zip(_SEGMENTS, one.power, strict=True):
                frequency_mhz, highest = _thinned(power, one.bin_hz * 1e-6)
                axes.plot(frequency_mhz, highest, linewidth=0.8, label=segment)
            threshold_db, label = 10.0 * np.log10(one.threshold), "detection threshold"
            axes.axhline(threshold_db, color="#d1495b", linestyle="--", linewidth=1.0, label=label)
            axes.set_title(
                f"shot {one.shot}, beam {one.beam}, {one.time_s:.2f} s: {one.range_m:.2f} m, "
                f"{one.closing_speed_mps:+.3f} m/s",
                loc="left",
                fontsize=9,
            )
            axes.set(ylim=(0.0, None), ylabel="dB over noise")
        figure.axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4)
        figure.axes[-1].set_xlabel("frequency (MHz); each point is the highest of its bins")

    description = (
        "Bin power of the three segments relative to noise, with the detection threshold: "
        + "; ".join(
            f"shot {one.shot}, beam {one.beam}, peaks at "
            + ", ".join(f"{power[1:-1].argmax() * one.bin_hz * 1e-6:.2f} MHz" for power in one.power)
            for one in spectra
        )
    )
    return draw_figure(
        "spectra", "Spectra of chosen shots", description + ".", 0.5 + 1.7 * len(spectra), plot
    )


def _thinned(power: FloatArray, bin_mhz: float) -> tuple[FloatArray, FloatArray]:
    """Reduce a spectrum to frequencies and highest powers in dB; the first and last bin hold no target."""
    parts = np.array_split(np.arange(1, len(power) - 1), min(_COLUMNS, len(power) - 2))
    at = np.array([part[power[part].argmax()] for part in parts])
    return at * bin_mhz, 10.0 * np.log10(np.maximum(power[at], 1e-3))


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
        self._model: Model | None = None
        try:
            self._model = build_model(run.recording.scenario)
        except InputError as error:
            self.notes.append(f"No ground, plan and spectra: the scenario cannot be built here ({error}).")
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
        yield from filter(None, [run_figures.draw_timeline(run)])
        if run.is_flight:
            yield from filter(None, [self._spectra(flight)])
        else:
            self.notes.append("No path and spectra: a bench pattern has no position and no receiver.")
        yield from filter(None, [run_figures.draw_lateness(run)])
        if not run.keeps_time:
            pace = f"at pace {run.recording.origin['pace']} packets have no deadline"
            self.notes.append(f"No lateness: {'packets waited for the host' if run.is_polled else pace}.")

    def _spectra(self, model: FlightModel | None) -> Drawing | None:
        if model is None:
            return None
        if model.scenario.live is not None:
            self.notes.append("No spectra: they are not recomputed from live truth.")
            return None
        measured = self._run.measurement
        try:
            places = choose_measurements(measured, self._at_s)
            spectra = [compute_spectra(model, measured, *place) for place in places]
            return draw_spectra(spectra) if spectra else None
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
