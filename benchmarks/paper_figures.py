"""Figures 2 to 5 of Budge et al., reproduced from the shipped scenarios: python -m benchmarks.paper_figures 2."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.tables import command_line
from lidar_emu.api import shot_spectra
from lidar_emu.beams.patterns import ScannerState
from lidar_emu.errors import Finding, InputError
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.receiver.returns import Echoes
from lidar_emu.receiver.whole_spectrum import find_peaks
from lidar_emu.report.descent_plot import plot_descent
from lidar_emu.report.plot_style import check_plot_path, write_plot
from lidar_emu.scenario.load import load, require_flight
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import BLOCK_SHOTS, measure_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_LEAST_APART_BINS = 8.0
"""Least separation of two targets that the spectrum resolves."""
_LEAST_SHARE = 0.05
_WITH_SPECKLE = {"level": "reference", "instrument.optics.speckle": True}


@dataclass(frozen=True)
class TwoTargets:
    """Spectrum of a beam with two targets at different ranges; powers are relative to the mean noise of a bin."""

    shot: int
    beam: int
    true_range_m: tuple[float, float]
    """Range of the nearest and of the farthest beamlet."""
    doppler_bin: float
    """Signed Doppler shift from the constant segment: offset between a chirp's peak and its range."""
    range_bin_m: float
    power: FloatArray
    """(N/2 + 1,) Windowed power of the down-chirp's bins."""
    threshold: float
    group_power: float
    """Least power of a bin that belongs to a target."""
    peak_bin: IntArray
    """(targets,) strongest first."""

    @property
    def range_m(self) -> FloatArray:
        """(targets,) Ranges of the peaks."""
        return np.asarray(self.peak_bin - self.doppler_bin) * self.range_bin_m


def find_two_targets(model: FlightModel) -> TwoTargets:
    """Find the beam of a flight whose footprint is shared most evenly by two targets and whose spectrum shows both.

    Raises:
        InputError: no beam of the flight has two targets.
    """
    for number, beam, before in _shared(model):
        found = _two_targets(model, number, beam, before)
        if len(found.peak_bin) > 1:
            return found
    nothing = Finding("no beam on two targets")
    raise InputError(model.scenario.name, None, nothing, "fly over trees, boulders or edges")


def _two_targets(model: FlightModel, number: int, beam: int, before: ScannerState) -> TwoTargets:
    scenario, detection = model.scenario, model.scenario.instrument.detection
    echoes, _ = _echoes(model, np.arange(number, number + 1, dtype=np.int64), before)
    spectra = shot_spectra(scenario, number, _WITH_SPECKLE)[beam]
    down = spectra["down"]
    power, threshold = (values / down.noise_power for values in (down.power, down.threshold))
    peaks = {
        name: find_peaks(one.power[None], one.threshold, detection.group_fraction)[0]
        for name, one in spectra.items()
    }
    range_m = echoes.range_m[0, beam]
    return TwoTargets(
        shot=number,
        beam=beam,
        true_range_m=(float(np.nanmin(range_m)), float(np.nanmax(range_m))),
        doppler_bin=float(np.copysign(peaks["constant"][0], echoes.closing_speed_mps[0, beam, 0])),
        range_bin_m=scenario.instrument.waveform.range_bin_m,
        power=power,
        threshold=float(threshold[1]),
        group_power=float(detection.group_fraction**2 * power.max()),
        peak_bin=peaks["down"][peaks["down"] >= 0],
    )


def _shared(model: FlightModel) -> Iterator[tuple[int, int, ScannerState]]:
    """Yield shots and beams whose footprints two targets share, the most evenly shared first, with the scanner's states
    before the shots."""
    state, found = model.initial_state, []
    least_apart_m = _LEAST_APART_BINS * model.scenario.instrument.waveform.range_bin_m
    for first in range(0, model.shot_count, BLOCK_SHOTS):
        before = state
        shot = np.arange(first, min(first + BLOCK_SHOTS, model.shot_count), dtype=np.int64)
        echoes, state = _echoes(model, shot, before)
        share = lesser_share(echoes.range_m, echoes.power_w, least_apart_m)
        found += [
            (share[after, beam], first, after, beam, before)
            for after, beam in np.argwhere(share > _LEAST_SHARE)
        ]
    found.sort(key=lambda each: -each[0])
    for _, first, after, beam, before in found:
        state = model.state_after(first, int(after), before) if after else before
        yield int(first + after), int(beam), state


def _echoes(model: FlightModel, shot: NDArray[np.int64], state: ScannerState) -> tuple[Echoes, ScannerState]:
    """Compute echoes, which are valid until the next call, and the scanner's state after them."""
    pointing, after = model.aim(shot, state)
    return model.echo_model.echoes(pointing, model.flight.cast(pointing)), after


def lesser_share(range_m: FloatArray, power_w: FloatArray, least_apart_m: float) -> FloatArray:
    """(...) Share of the power of beamlets (..., beamlets) from the weaker side of the widest gap in range.

    It is 0 where the gap is narrower than `least_apart_m`, or there is no power.
    """
    order = np.argsort(range_m, axis=-1)
    sorted_m, sorted_w = (np.take_along_axis(array, order, axis=-1) for array in (range_m, power_w))
    ahead_m = np.nan_to_num(np.diff(sorted_m, axis=-1, prepend=sorted_m[..., :1]), nan=0.0)
    first_far = ahead_m.argmax(axis=-1)[..., None]
    sorted_w = np.nan_to_num(sorted_w, nan=0.0)
    total_w = sorted_w.sum(axis=-1)
    before_w = np.cumsum(sorted_w, axis=-1) - sorted_w
    near = np.take_along_axis(before_w, first_far, axis=-1)[..., 0] / np.where(total_w > 0, total_w, np.inf)
    return np.where(ahead_m.max(axis=-1) > least_apart_m, np.minimum(near, 1.0 - near), 0.0)


_SIZE_INCH = (16.0, 14.5)
_DOTS_PER_INCH = 100
_DECIBELS = (-14.0, 44.0)
_NEAR_BINS = 14
"""Margin beside the outer targets in the close view."""
_SLICE_M = 2.5
"""Along-track length of the slice shown from behind."""
_PAIRS_M = 9.0
"""Across-track width of the close view from above."""
_SPEED_COLOURS = "coolwarm"


def plot_scan(measurement: Measurement, spectrum: TwoTargets, title: str, path: Path) -> None:
    """Plot a scanned flight as a PNG of 1600 by 1450 pixels.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_INCH, dpi=_DOTS_PER_INCH)
    figure.suptitle(title, x=0.5, y=0.985, fontsize=17)
    _add_spectrum(figure, spectrum)
    speed_mmps = 1e3 * measurement.closing_speed_mps
    for left, values, colours, label in (
        (0.0, measurement.range_m, "viridis", "range (m)"),
        (0.5, speed_mmps, _SPEED_COLOURS, "closing speed (mm/s)"),
    ):
        _add_cloud(figure, (left, 0.27, 0.43, 0.44), measurement, values, colours, label)
    _add_slice(figure.add_axes((0.06, 0.05, 0.55, 0.2)), measurement, spectrum.range_bin_m)
    _add_pairs(figure.add_axes((0.68, 0.05, 0.29, 0.2)), measurement, speed_mmps)
    write_plot(figure, path)


def _add_spectrum(figure: Figure, spectrum: TwoTargets) -> None:
    bins = np.arange(len(spectrum.power))
    whole = figure.add_axes((0.06, 0.765, 0.44, 0.175))
    close = figure.add_axes((0.56, 0.765, 0.41, 0.175), sharey=whole)
    low, high = spectrum.peak_bin.min() - _NEAR_BINS, spectrum.peak_bin.max() + _NEAR_BINS
    for axes, first, end in ((whole, 1, len(bins) - 1), (close, low, high + 1)):
        decibels = 10.0 * np.log10(np.maximum(spectrum.power[first:end], 1e-9))
        axes.plot(bins[first:end], decibels, color="C0", linewidth=0.7 if axes is whole else 1.2, zorder=2)
        axes.axhline(0.0, color="0.35", linewidth=1.0, label="mean noise", zorder=3)
        axes.axhline(
            10.0 * np.log10(spectrum.threshold), color="C3", linewidth=1.2, label="threshold", zorder=3
        )
        axes.axhline(
            10.0 * np.log10(spectrum.group_power),
            color="C1",
            linestyle="--",
            label="30 % of the peak",
            zorder=3,
        )
        heights = 10.0 * np.log10(spectrum.power[spectrum.peak_bin])
        axes.plot(spectrum.peak_bin, heights, "o", color="C2", label="detected", zorder=4)
        axes.set(ylim=_DECIBELS, xlim=(bins[first], bins[end - 1]), xlabel="bin of the down-chirp's FFT")
        axes.grid(color="0.92")
    for place, range_m in zip(spectrum.peak_bin, spectrum.range_m, strict=True):
        height = 10.0 * np.log10(spectrum.power[place])
        close.annotate(f" {range_m:.2f} m", (place, height), textcoords="offset points", xytext=(6, 2))
    whole.set_ylabel("power over mean noise (dB)")
    whole.legend(frameon=False, ncols=4, loc="lower right", bbox_to_anchor=(1.0, 0.99))


def _add_cloud(
    figure: Figure,
    place: tuple[float, float, float, float],
    measurement: Measurement,
    values: FloatArray,
    colours: str,
    label: str,
) -> None:
    valid = measurement.range_valid & measurement.speed_valid
    points_m = measurement.point_site_m[valid]
    axes: Any = figure.add_axes(place, projection="3d")
    axes.set_box_aspect(np.ptp(points_m, axis=0), zoom=1.05)
    axes.view_init(elev=34, azim=-62)
    drawn = axes.scatter(*points_m.T, c=values[valid], cmap=colours, s=5, linewidths=0, depthshade=False)
    axes.set(xlabel="east (m)", ylabel="north (m)", zlabel="up (m)")
    axes.zaxis.set_major_locator(_few_ticks())
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((1, 1, 1, 0))
    left, bottom, width, height = place
    bar = figure.colorbar(
        drawn, cax=figure.add_axes((left + width + 0.015, bottom + 0.1, 0.01, height - 0.2))
    )
    bar.set_label(label)


def _few_ticks() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(nbins=4, steps=[1, 2, 5, 10])


def _add_slice(axes: Axes, measurement: Measurement, range_bin_m: float) -> None:
    """Draw the points of a few scan lines from behind, and arcs at whole range bins below the sensor."""
    shown = slice_of(measurement, _SLICE_M)
    points_m = measurement.point_site_m[shown]
    axes.plot(points_m[:, 0], points_m[:, 2], ".", color="C0", markersize=5, zorder=3)
    sensor_up_m = float(measurement.position_site_m[len(measurement) // 2, 2])
    east_m = np.linspace(points_m[:, 0].min(), points_m[:, 0].max(), 200)
    low, high = (sensor_up_m - limit_m for limit_m in (points_m[:, 2].max(), points_m[:, 2].min()))
    for whole in np.arange(np.floor(low / range_bin_m), np.ceil(1.01 * high / range_bin_m)):
        arc_m = sensor_up_m - np.sqrt((whole * range_bin_m) ** 2 - east_m**2)
        axes.plot(east_m, arc_m, color="0.85", linewidth=0.6, zorder=1)
    margin_m = 2 * range_bin_m
    axes.set(xlabel="east (m)", ylabel="up (m)", xlim=(east_m[0] - 1, east_m[-1] + 1))
    axes.set_ylim(points_m[:, 2].min() - margin_m, points_m[:, 2].max() + margin_m)
    axes.set_title(
        f"{_SLICE_M:g} m of the flight from behind; grey: whole range bins, {range_bin_m:.4f} m apart",
        fontsize=10,
    )


def _add_pairs(axes: Axes, measurement: Measurement, speed_mmps: FloatArray) -> None:
    """Draw the points of a few scan lines from above: the beams point slightly forward and aft."""
    seen = measurement.range_valid & measurement.speed_valid
    points_m = measurement.point_site_m
    axes.scatter(
        points_m[seen][:, 0],
        points_m[seen][:, 1],
        c=speed_mmps[seen],
        cmap=_SPEED_COLOURS,
        s=28,
        linewidths=0,
    )
    middle_m = measurement.position_site_m[len(measurement) // 2, :2]
    axes.set_xlim(middle_m[0] - _PAIRS_M / 2, middle_m[0] + _PAIRS_M / 2)
    axes.set_ylim(middle_m[1] - _SLICE_M, middle_m[1] + _SLICE_M)
    axes.set(xlabel="east (m)", ylabel="north (m)")
    axes.set_title("close view from above, by closing speed", fontsize=10)


def slice_of(measurement: Measurement, length_m: float) -> BoolArray:
    """(shots, beams) Whether a point is valid and within half a length of the middle of the flight, along track."""
    middle_m = measurement.position_site_m[len(measurement) // 2, 1]
    near = np.abs(measurement.point_site_m[..., 1] - middle_m) <= length_m / 2
    return np.asarray(near & measurement.range_valid)


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
    other_target: int
    """Measurements of the other of two targets in a footprint: the errors below are without them."""
    whole_range_deviation_m: float
    """With them."""
    range_mean_m: float
    range_deviation_m: float
    speed_mean_mps: float
    speed_deviation_mps: float


def errors_of(measurement: Measurement, range_bin_m: float) -> Errors:
    """Compute mean and standard deviation of the errors over all beams and shots.

    An error beyond what separates two targets in the spectrum is no error of the receiver: the beam's axis met one of
    them, and the other's line was the highest.
    """
    valid = measurement.range_valid & measurement.speed_valid
    range_m = (measurement.range_m - measurement.true_range_m)[valid]
    speed_mps = (measurement.closing_speed_mps - measurement.true_closing_speed_mps)[valid]
    same = np.abs(range_m) < _LEAST_APART_BINS * range_bin_m
    moments = (
        float(value) for error in (range_m[same], speed_mps[same]) for value in (error.mean(), error.std())
    )
    counts = int(valid.sum()), int(measurement.fired.sum()), int((~same).sum())
    return Errors(*counts, float(range_m.std()), *moments)


if __name__ == "__main__":
    parser = command_line(__doc__)
    parser.add_argument("figures", nargs="*", metavar="FIGURE", default="2345", help="such as 2, or 2.pdf")
    for name in parser.parse_args().figures:
        figure, _, suffix = name.partition(".")
        plot = Path(f"paper_fig{figure}.{suffix or 'png'}")
        waveform = require_flight(load(f"paper_fig{figure}")).instrument.waveform
        errors = errors_of(plot_paper_figure(figure, plot), waveform.range_bin_m)
        print(f"{plot}: {errors.measured} of {errors.fired} beams measured")
        print(
            f"range error: mean {errors.range_mean_m:+.4f} m, standard deviation {errors.range_deviation_m:.4f} m"
        )
        if errors.other_target:
            print(
                f"  without {errors.other_target} that measured the other of two targets in their footprint; "
                f"with them {errors.whole_range_deviation_m:.4f} m"
            )
        print(
            f"speed error: mean {1e3 * errors.speed_mean_mps:+.4f} mm/s, "
            f"standard deviation {1e3 * errors.speed_deviation_mps:.4f} mm/s"
        )
