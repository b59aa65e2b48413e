"""Values over time: ranges, speeds, their errors, lateness, and what happened."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.fmcw.reasons import Reason
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.recording.json_messages import JsonMessage
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.runtime.port.packets import DeliveryStatus
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

Event = tuple[float, str, str]
"""Scenario time in seconds, level, text."""


def log_values(stream: rr.RecordingStream, run: RecordedRun) -> None:
    """Log measurements of each beam where they are valid, and the lateness of packets at pace `wall`."""
    measured = run.measurement
    for name, values, valid in _of_beams(measured):
        for beam in range(measured.beam_count):
            of_beam = valid[:, beam] & np.isfinite(values[:, beam])
            time_s = seconds(measured.time_ns[of_beam, beam])
            colour = _BEAMS_RGB[beam % len(_BEAMS_RGB)]
            _log_points(stream, f"{name}/beam_{beam}", time_s, values[of_beam, beam], colour)
    if run.keeps_time:
        sent = run.deliveries.status == DeliveryStatus.SENT
        due_s = seconds(run.deliveries.due_ns[sent])
        _log_points(stream, "lateness_us/packets", due_s, run.lateness_us, _BEAMS_RGB[0])


def _of_beams(measured: Measurement) -> Iterator[tuple[str, FloatArray, BoolArray]]:
    """Name, values (shots, beams) and whether they are valid."""
    range_m, speed_mps = measured.range_m, measured.closing_speed_mps
    yield "range_m", range_m, measured.range_valid
    yield "closing_speed_mps", speed_mps, measured.speed_valid
    yield "range_error_m", range_m - measured.true_range_m, measured.range_valid
    yield "closing_speed_error_mps", speed_mps - measured.true_closing_speed_mps, measured.speed_valid


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

    events = sorted([*_lost_beams(run.measurement), *_faults(run), *_messages(run)])
    columns = rr.TextLog.columns(
        text=[text for _, _, text in events], level=[level for _, level, _ in events]
    )
    send(stream, "events", [time_s for time_s, _, _ in events], columns)


def _lost_beams(measured: Measurement) -> Iterator[Event]:
    """Beams whose ranges become invalid, with the reason, and valid again."""
    valid = measured.range_valid
    for beam in range(measured.beam_count):
        changes = np.flatnonzero(np.diff(valid[:, beam], prepend=True))
        for shot in changes.tolist():
            time_s = float(measured.time_ns[shot, beam] * 1e-9)
            if valid[shot, beam]:
                yield time_s, "INFO", f"beam {beam}: valid"
            else:
                yield time_s, "WARN", f"beam {beam}: {Reason(measured.reason[shot, beam]).name.lower()}"


def _faults(run: RecordedRun) -> Iterator[Event]:
    """The first shot of each time that a fault acts: shots that follow one another are one time."""
    period_s = 1 / run.recording.scenario.timing.rate_hz
    for kind, times_ns in run.faults_ns.items():
        acted_s = seconds(np.unique(times_ns))
        first = np.diff(acted_s, prepend=-np.inf) > 1.5 * period_s
        for time_s in acted_s[first].tolist():
            yield time_s, "ERROR", f"fault: {kind}"


def _messages(run: RecordedRun) -> Iterator[Event]:
    for level, what, messages in (
        ("ERROR", "injected", run.injected_faults),
        ("INFO", "command", run.commands),
        ("INFO", "event", run.events),
    ):
        for message in messages:
            yield message.time_ns * 1e-9, level, f"{what}: {_text(message)}"


def _text(message: JsonMessage) -> str:
    return ", ".join(f"{name} {value}" for name, value in message.values.items() if value not in (None, {}))
