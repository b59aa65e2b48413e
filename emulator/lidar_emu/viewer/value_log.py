"""Values over time and events, for Rerun."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.runtime.port.packets import DeliveryStatus
from lidar_emu.viewer.beam_values import beam_values
from lidar_emu.viewer.events import events_of
from lidar_emu.viewer.timeline import seconds, send

if TYPE_CHECKING:
    import rerun as rr

Rgb = tuple[int, int, int]
_BEAMS_RGB: list[Rgb] = [
    (31, 119, 180),
    (255, 127, 14),
    (44, 160, 44),
    (214, 39, 40),
    (148, 103, 189),
    (140, 86, 75),
]
"""Colours of beams 0, 1, ..., then again from the first."""


def log_values(stream: rr.RecordingStream, run: RecordedRun) -> None:
    """Log measurements of each beam where they are valid, and the lateness of packets at pace `wall`."""
    measured = run.measurement
    for name, values in beam_values(measured).items():
        for beam in range(measured.beam_count):
            of_beam = np.isfinite(values[:, beam])
            time_s = seconds(measured.time_ns[of_beam, beam])
            colour = _BEAMS_RGB[beam % len(_BEAMS_RGB)]
            _log_points(stream, f"{name}/beam_{beam}", time_s, values[of_beam, beam], colour)
    if run.keeps_time:
        sent = run.deliveries.status == DeliveryStatus.SENT
        due_s = seconds(run.deliveries.due_ns[sent])
        _log_points(stream, "lateness_us/packets", due_s, run.lateness_us, _BEAMS_RGB[0])


def _log_points(
    stream: rr.RecordingStream, entity: str, time_s: FloatArray, values: FloatArray, colour: Rgb
) -> None:
    import rerun as rr

    label = entity.rpartition("/")[2].replace("_", " ")
    style = rr.SeriesPoints(markers="circle", marker_sizes=1.5, names=label, colors=[colour])
    stream.log(entity, style, static=True)
    send(stream, entity, time_s, rr.Scalars.columns(scalars=values))


def log_events(stream: rr.RecordingStream, run: RecordedRun) -> None:
    """Log beams that are lost and found, faults, commands, and events of the link and of the processes."""
    import rerun as rr

    events = events_of(run)
    columns = rr.TextLog.columns(
        text=[event.text for event in events], level=[event.level for event in events]
    )
    send(stream, "events", [event.time_ns * 1e-9 for event in events], columns)
