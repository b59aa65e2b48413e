"""Figures of how a run went: what was valid and why not, how late packets were, what acted and when."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.fmcw.reasons import Reason
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.recording.read import JsonMessage
from lidar_emu.report.page_style import Drawing, draw
from lidar_emu.report.recorded_run import RecordedRun

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_STRETCHES = 200
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
"""Kinds and commands that have a line of their own."""


def validity(measurement: Measurement) -> Drawing:
    """Shares of beams that are valid, and of the reasons why the others are not, over time."""
    time_s = measurement.time_ns[:, 0] * 1e-9
    stretches = np.array_split(np.arange(len(measurement)), min(_STRETCHES, len(measurement)))
    begins_s = np.array([time_s[stretch[0]] for stretch in stretches] + [time_s[-1]])
    found = [Reason(code) for code in np.unique(measurement.reason)]
    shares = {
        reason: np.array([(measurement.reason[stretch] == reason).mean() for stretch in stretches])
        for reason in found
    }

    def on(figure: Figure) -> None:
        axes = figure.subplots()
        heights = [np.append(share, share[-1]) for share in shares.values()]
        labels = [_words(reason) for reason in shares]
        colours = [_COLOURS[reason] for reason in shares]
        axes.stackplot(begins_s, heights, step="post", labels=labels, colors=colours, linewidth=0)
        axes.set(ylim=(0, 1), ylabel="share of beams", xlabel="time (s)")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02))

    whole = measurement.reason.size
    said = ", ".join(f"{_words(r)} {100 * (measurement.reason == r).sum() / whole:.1f} %" for r in found)
    return draw(
        "validity", "Validity and reasons", f"Share of the beams over time by reason: {said}.", 2.4, on
    )


def _words(reason: Reason) -> str:
    return reason.name.lower().replace("_", " ")


def lateness(flown: RecordedRun) -> Drawing | None:
    """How late packets went out: a histogram, and the run's course; None where none had an instant to keep."""
    late_us = flown.lateness_us
    if not (flown.keeps_time and late_us.size):
        return None
    due_s = flown.packets.due_ns[flown.packets.sent_ns >= 0] * 1e-9

    def on(figure: Figure) -> None:
        spread, course = figure.subplots(1, 2)
        shown_us = np.maximum(late_us, _LEAST_US)
        bins = np.geomspace(shown_us.min() * 0.99, max(shown_us.max(), 10.0) * 1.01, 80)
        spread.hist(shown_us, bins=bins.tolist(), color="C0", alpha=0.8)
        spread.set(
            xscale="log", yscale="log", xlabel="due to written (us)", ylabel="packets", ylim=(0.7, None)
        )
        stretches = np.array_split(np.argsort(due_s, kind="stable"), min(_STRETCHES, len(due_s)))
        begins_s = [due_s[stretch[0]] for stretch in stretches]
        for label, quantile in (("largest", 1.0), ("median", 0.5)):
            values = [np.quantile(shown_us[stretch], quantile) for stretch in stretches]
            course.plot(begins_s, values, ".-", linewidth=0.8, markersize=3, label=label)
        course.set(yscale="log", xlabel="time (s)", ylabel="due to written (us)")
        course.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)

    median, high = np.quantile(late_us, (0.5, 0.99))
    says = f"From due to written: median {median:.0f} us, 99 % below {high:.0f} us, largest {late_us.max():.0f} us."
    return draw("lateness", "Lateness", says, 2.8, on)


def timeline(flown: RecordedRun) -> Drawing | None:
    """When faults acted, commands came and something happened; None where nothing did."""
    marks = _marks(flown)
    if not marks:
        return None
    names = list(marks)[:_WRITTEN_OUT]

    def on(figure: Figure) -> None:
        axes = figure.subplots()
        for row, name in enumerate(names):
            _add_marks(axes, row, marks[name], name)
        axes.set_yticks(range(len(names)), names)
        axes.set(ylim=(len(names) - 0.4, -0.6), xlabel="time (s)")
        time_s = flown.measurement.time_ns * 1e-9
        first_s, last_s = min(time_s.min(), *(m.min() for m in marks.values())), time_s.max()
        margin_s = 0.01 * (last_s - first_s) + 1e-3
        axes.set_xlim(first_s - margin_s, last_s + margin_s)

    said = "; ".join(f"{name} {len(times)} times from {times.min():.1f} s" for name, times in marks.items())
    return draw(
        "timeline", "Faults, commands, events", f"When what happened: {said}.", 0.8 + 0.28 * len(names), on
    )


def _marks(flown: RecordedRun) -> dict[str, FloatArray]:
    """Times in seconds by what happened then."""
    named: list[tuple[str, JsonMessage]] = [
        *((f"fault {told.values['kind']}", told) for told in flown.faults),
        *((f"order {told.values['definition'].get('kind')}", told) for told in flown.ordered),
        *((f"command {told.values['command']}", told) for told in flown.commands),
        *((f"{told.values['of']} event", told) for told in flown.events),
    ]
    times: dict[str, list[float]] = {}
    for name, told in named:
        times.setdefault(name.replace("_", " "), []).append(told.time_ns * 1e-9)
    return {name: np.array(sorted(values)) for name, values in times.items()}


def _add_marks(axes: Axes, row: int, times_s: FloatArray, name: str) -> None:
    colour = "#d1495b" if name.startswith(("fault", "order")) else "C0"
    axes.plot(times_s, np.full(len(times_s), row), "|", color=colour, markersize=11, rasterized=True)
