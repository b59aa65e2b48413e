"""Figures of a run: validity of the beams, lateness of the packets, and times of faults, commands and events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.receiver.returns import Reason
from lidar_emu.recording.channels import JsonMessage
from lidar_emu.report.beam_colours import beam_colour
from lidar_emu.report.plot_style import (
    Drawing,
    beam_points,
    check_plot_path,
    draw_figure,
    name_beams,
    styled,
    titled_figure,
    write_plot,
)
from lidar_emu.report.recorded_run import RecordedRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_STRETCHES = 200
_STRIP_STRETCHES = 800
_LEAST_US = 1.0
_COLOURS = {
    Reason.VALID: "#5aa469",
    Reason.NOT_FIRED: "#9aa0a8",
    Reason.NO_SURFACE: "#7fb3d5",
    Reason.BELOW_THRESHOLD: "#e0a030",
    Reason.BEYOND_RANGE: "#8e6bbf",
    Reason.INSIDE_GROUND: "#8c564b",
    Reason.AMBIGUOUS: "#d1495b",
}
_WRITTEN_OUT = 12
"""Largest number of rows in the timeline."""


def draw_signal(measurement: Measurement) -> Drawing:
    """Draw the signal-to-noise ratio of each beam, and its reasons for invalid ranges, over time."""
    time_s = np.asarray(measurement.time_ns * 1e-9, dtype=np.float64)
    beams = measurement.beam_count
    stretches = np.array_split(np.arange(len(measurement)), min(_STRIP_STRETCHES, len(measurement)))
    edges_s = np.append(time_s[[stretch[0] for stretch in stretches], 0], time_s[-1, 0])
    tints = np.zeros((max(Reason) + 1, 3))
    for reason, colour in _COLOURS.items():
        tints[reason] = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    strip = np.stack([tints[measurement.reason[stretch]].mean(axis=0) for stretch in stretches], axis=1)
    found = [Reason(code) for code in np.unique(measurement.reason)]

    def plot(figure: Figure) -> None:
        above, below = figure.subplots(2, sharex=True, height_ratios=(2.0, 1.0 + 0.1 * min(beams, 10)))
        for beam in range(beams):
            known = np.isfinite(measurement.snr_db[:, beam])
            beam_points(above, beam, beams, time_s[known, beam], measurement.snr_db[known, beam])
            above.plot([], [], ".", color=beam_colour(beam), label=f"beam {beam}")
        above.set_ylabel("SNR (dB)")
        name_beams(above, beams)
        below.pcolormesh(edges_s, np.arange(beams + 1) - 0.5, strip, rasterized=True)
        below.grid(visible=False)
        below.yaxis.get_major_locator().set_params(integer=True)
        below.set(ylabel="beam", xlabel="time (s)", ylim=(beams - 0.5, -0.5))
        for reason in found:
            below.plot([], [], "s", color=_COLOURS[reason], label=_words(reason))
        below.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), handletextpad=0.1)

    snr_db = measurement.snr_db[np.isfinite(measurement.snr_db)]
    levels = "none stated"
    if snr_db.size:
        low, median, high = np.quantile(snr_db, (0.05, 0.5, 0.95))
        levels = f"median {median:.1f} dB, 5th and 95th percentile {low:.1f} and {high:.1f} dB"
    description = f"Signal-to-noise ratio over time ({levels}), and validity of each beam over time."
    return draw_figure("signal", "Signal and validity of each beam", description, 3.6, plot)


def draw_validity(measurement: Measurement) -> Drawing:
    """Draw the shares of valid beams, and of the reasons of invalid ones, over time."""
    time_s = measurement.time_ns[:, 0] * 1e-9
    stretches = np.array_split(np.arange(len(measurement)), min(_STRETCHES, len(measurement)))
    begins_s = np.array([time_s[stretch[0]] for stretch in stretches] + [time_s[-1]])
    found = [Reason(code) for code in np.unique(measurement.reason)]
    shares = {
        reason: np.array([(measurement.reason[stretch] == reason).mean() for stretch in stretches])
        for reason in found
    }

    def plot(figure: Figure) -> None:
        axes = figure.subplots()
        heights = [np.append(share, share[-1]) for share in shares.values()]
        labels = [_words(reason) for reason in shares]
        colours = [_COLOURS[reason] for reason in shares]
        axes.stackplot(begins_s, heights, step="post", labels=labels, colors=colours, linewidth=0)
        axes.set(ylim=(0, 1), ylabel="share of beams", xlabel="time (s)")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02))

    whole = measurement.reason.size
    counts = ", ".join(f"{_words(r)} {100 * (measurement.reason == r).sum() / whole:.1f} %" for r in found)
    description = f"Share of the beams over time by reason: {counts}."
    return draw_figure("validity", "Validity and reasons", description, 2.4, plot)


def _words(reason: Reason) -> str:
    return reason.name.lower().replace("_", " ")


def draw_lateness(run: RecordedRun) -> Drawing | None:
    """Draw the distribution and the course of packet lateness; None for a run without deadlines."""
    late_us = run.lateness_us
    if not (run.keeps_time and late_us.size):
        return None
    due_s = run.deliveries.due_ns[run.deliveries.sent_ns >= 0] * 1e-9

    def plot(figure: Figure) -> None:
        spread, course = figure.subplots(1, 2)
        shown_us = np.maximum(late_us, _LEAST_US)
        bins = np.geomspace(shown_us.min() * 0.99, max(shown_us.max(), 10.0) * 1.01, 80)
        spread.hist(shown_us, bins=bins.tolist(), color="C0", alpha=0.8)
        spread.set(
            xscale="log", yscale="log", xlabel="due to written (us)", ylabel="packets", ylim=(0.7, None)
        )
        stretches = np.array_split(np.argsort(due_s, kind="stable"), min(_STRETCHES, len(due_s)))
        begins_s = [due_s[stretch[0]] for stretch in stretches]
        for label, quantile in (("largest", 1.0), ("50th percentile", 0.5)):
            values = [np.quantile(shown_us[stretch], quantile) for stretch in stretches]
            course.plot(begins_s, values, ".-", linewidth=0.8, markersize=3, label=label)
        course.set(yscale="log", xlabel="time (s)", ylabel="due to written (us)")
        course.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02))

    median, high = np.quantile(late_us, (0.5, 0.99))
    statistics = f"50th percentile {median:.0f} us, 99th {high:.0f} us, largest {late_us.max():.0f} us"
    return draw_figure("lateness", "Lateness", f"From due to written: {statistics}.", 2.8, plot)


def draw_timeline(run: RecordedRun) -> Drawing | None:
    """Draw the times of faults, commands and events; None if there are none."""
    marks = _marks(run)
    if not marks:
        return None
    names = list(marks)[:_WRITTEN_OUT]

    def plot(figure: Figure) -> None:
        axes = figure.subplots()
        for row, name in enumerate(names):
            colour = "#d1495b" if name.startswith(("fault", "injected")) else "C0"
            at_row = np.full(len(marks[name]), row)
            axes.plot(marks[name], at_row, "|", color=colour, markersize=11, rasterized=True)
        axes.set_yticks(range(len(names)), names)
        axes.set(ylim=(len(names) - 0.4, -0.6), xlabel="time (s)")
        time_s = run.measurement.time_ns * 1e-9
        first_s, last_s = min(time_s.min(), *(m.min() for m in marks.values())), time_s.max()
        margin_s = 0.01 * (last_s - first_s) + 1e-3
        axes.set_xlim(first_s - margin_s, last_s + margin_s)

    counts = "; ".join(f"{name} {len(times)} times from {times.min():.1f} s" for name, times in marks.items())
    description, height_inch = f"Times of faults, commands and events: {counts}.", 0.8 + 0.28 * len(names)
    return draw_figure("timeline", "Faults, commands, events", description, height_inch, plot)


def _marks(run: RecordedRun) -> dict[str, FloatArray]:
    named: list[tuple[str, JsonMessage]] = [
        *((f"injected {each.values['definition'].get('kind')}", each) for each in run.injected_faults),
        *((f"command {each.values['command']}", each) for each in run.commands),
        *((f"{each.values['of']} event", each) for each in run.events),
    ]
    times_ns: dict[str, list[int]] = {}
    for name, message in named:
        times_ns.setdefault(name, []).append(message.time_ns)
    marks = {f"fault {kind}": occurrences_ns for kind, occurrences_ns in run.faults_ns.items()} | times_ns
    return {name.replace("_", " "): np.sort(values) * 1e-9 for name, values in marks.items()}


_SIZE_INCH = (16.0, 8.0)
_BINS = 120


@dataclass(frozen=True)
class LatenessCurve:
    """Lateness of one run."""

    label: str
    lateness_ns: IntArray
    """Lateness of all shots, in any order."""
    at_s: Sequence[int]
    """Start of each window."""
    p99_ns: Sequence[int | None]
    """99th percentile of each window; None for a window without shots."""


@styled
def plot_lateness(curves: Sequence[LatenessCurve], title: str, path: Path) -> None:
    """Plot a PNG of 1600 by 800 pixels.

    Args:
        curves: runs to overlay.
        title: title of the figure.
        path: file, `.png`, `.svg` or `.pdf`.

    Raises:
        InputError: see `check_plot_path`.
        RunError: writing failed.
    """
    check_plot_path(path)
    figure = titled_figure(title, _SIZE_INCH, 15, dpi=100)
    spread, seconds = figure.subplots(1, 2)
    values_us = [np.maximum(_LEAST_US, curve.lateness_ns / 1e3) for curve in curves]
    everything = np.concatenate([*values_us, [10.0]])
    bins = np.geomspace(everything.min() * 0.99, everything.max() * 1.01, _BINS)
    for curve, values in zip(curves, values_us, strict=True):
        spread.hist(values, bins=bins.tolist(), histtype="step", linewidth=1.5, label=curve.label)
        p99_us = [np.nan if value is None else value / 1e3 for value in curve.p99_ns]
        seconds.plot(curve.at_s, p99_us, marker=".", linewidth=1, label=curve.label)
    spread.set(xscale="log", yscale="log", xlabel="due to written (us)", ylabel="shots")
    seconds.set(yscale="log", xlabel="time (s)", ylabel="p99 of each second, due to written (us)")
    seconds.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), fontsize=9)
    for axes in (spread, seconds):
        axes.grid(alpha=0.3)
    write_plot(figure, path)
