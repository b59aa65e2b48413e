"""Values over time and events, for Rerun."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.runtime.port.packets import DeliveryStatus
from lidar_emu.viewer.beam_values import beam_values
from lidar_emu.viewer.events import Event
from lidar_emu.viewer.timeline import seconds, send
from lidar_emu.viewer.views import LATENESS, beam_rgb, plots

if TYPE_CHECKING:
    import rerun as rr


def log_values(stream: rr.RecordingStream, run: RecordedRun) -> None:
    """Log measurements of each beam where they are valid, and the lateness of packets at pace `wall`."""
    measured = run.measurement
    for name, values in beam_values(measured).items():
        for beam in range(measured.beam_count):
            of_beam = np.isfinite(values[:, beam])
            time_s = seconds(measured.time_ns[of_beam, beam])
            _log_points(stream, f"{name}/beam_{beam}", time_s, values[of_beam, beam])
    if run.keeps_time:
        sent = run.deliveries.status == DeliveryStatus.SENT
        due_s = seconds(run.deliveries.due_ns[sent])
        _log_points(stream, f"{LATENESS}/packets", due_s, run.lateness_us)


def log_styles(stream: rr.RecordingStream, beam_count: int, keeps_time: bool) -> None:
    """Log how the plots show their values."""
    for name in plots(keeps_time):
        curves = ["packets"] if name == LATENESS else [f"beam_{beam}" for beam in range(beam_count)]
        for number, curve in enumerate(curves):
            _log_style(stream, f"{name}/{curve}", beam_rgb(number))


def _log_style(stream: rr.RecordingStream, entity: str, colour: str) -> None:
    import rerun as rr

    label = entity.rpartition("/")[2].replace("_", " ")
    rgb = list(bytes.fromhex(colour.removeprefix("#")))
    style = rr.SeriesPoints(markers="circle", marker_sizes=1.5, names=label, colors=[rgb])
    stream.log(entity, style, static=True)


def _log_points(stream: rr.RecordingStream, entity: str, time_s: FloatArray, values: FloatArray) -> None:
    import rerun as rr

    send(stream, entity, time_s, rr.Scalars.columns(scalars=values))


def log_events(stream: rr.RecordingStream, events: list[Event]) -> None:
    """Log events."""
    import rerun as rr

    columns = rr.TextLog.columns(
        text=[event.text for event in events], level=[event.level for event in events]
    )
    send(stream, "events", [event.time_ns * 1e-9 for event in events], columns)
