"""Spectra of selected shots of a recording, recomputed from its scenario sample by sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.fmcw.receiver_constants import build_receiver
from lidar_emu.fmcw.waveform.level import measure_one_beam
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.page_style import Drawing, draw_figure
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import state_before

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
    """Compute the spectra of one measurement, with the run's speckle and another realisation of the noise.

    Raises:
        NoSpectraError: the scenario alone does not determine where the beam pointed, or the instrument's detection
            cannot be computed from samples.
    """
    scenario, shot = model.scenario, measurement.shot[row : row + 1]
    first = int(shot[0])
    pointing, _ = model.aim(shot, state_before(model, first))
    hits = model.flight.cast(pointing)
    apart_m = abs(hits.range_m[0, beam] - measurement.true_range_m[row, beam])
    if not (pointing.fired[0, beam] and apart_m <= _SAME_M * measurement.true_range_m[row, beam]):
        raise NoSpectraError(
            f"shot {first} differs from the scenario alone: commands changed the flight before it"
        )
    receiver = build_receiver(scenario.instrument, scenario.site, scenario.left_out_share)
    echoes = model.echo_model.echoes(pointing, hits)
    try:
        received = measure_one_beam(scenario.instrument, receiver, echoes, shot, scenario.seed, 0, beam)
    except ValueError as error:
        raise NoSpectraError(
            f"the detection of this instrument cannot be computed from samples: {error}"
        ) from None
    assert received.bins is not None
    noise = np.broadcast_to(received.noise_power, received.bins.shape[-1:])
    return Spectra(
        shot=first,
        beam=beam,
        time_s=float(measurement.time_ns[row, beam] * 1e-9),
        range_m=float(measurement.range_m[row, beam]),
        closing_speed_mps=float(measurement.closing_speed_mps[row, beam]),
        power=np.abs(received.bins[0]) ** 2 / np.maximum(noise, np.finfo(float).tiny),
        threshold=receiver.threshold,
        bin_hz=scenario.instrument.waveform.bin_width_hz,
    )


def draw_spectra(spectra: list[Spectra]) -> Drawing:
    """Draw spectra, a row per measurement."""

    def plot(figure: Figure) -> None:
        for axes, one in zip(np.atleast_1d(figure.subplots(len(spectra), sharex=True)), spectra, strict=True):
            for segment, power in zip(_SEGMENTS, one.power, strict=True):
                frequency_mhz, highest = _thinned(power, one.bin_hz * 1e-6)
                axes.plot(frequency_mhz, highest, linewidth=0.8, label=segment)
            axes.axhline(
                10.0 * np.log10(one.threshold),
                color="#d1495b",
                linestyle="--",
                linewidth=1.0,
                label="detection threshold",
            )
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
