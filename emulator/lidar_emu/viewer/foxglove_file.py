"""Write a recording with the schemas of Foxglove, as MCAP."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from mcap_protobuf.writer import Writer

from lidar_emu.files import whole_file
from lidar_emu.measurement import Measurement
from lidar_emu.report.exports import dark_to_bright_rgb
from lidar_emu.report.ground_below import extent_of
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.runtime.port.packets import DeliveryStatus
from lidar_emu.viewer import foxglove_messages as messages
from lidar_emu.viewer.beam_values import beam_values
from lidar_emu.viewer.events import events_of
from lidar_emu.viewer.ground_mesh import ground_mesh, scene_of

_Message = tuple[int, str, Any]
"""Scenario time in nanoseconds, topic, message."""


def write_foxglove(run: RecordedRun, path: Path) -> list[str]:
    """Write the messages in the order of their times; returns what is missing, with the reasons.

    The times are those of the recording's own topics: scenario time on the scenario's epoch.

    Raises:
        InputError: the path cannot be written.
        RunError: writing failed.
    """
    notes: list[str] = []
    epoch_ns = run.recording.epoch_ns
    streams = [_values(run.measurement, epoch_ns), _events(run, epoch_ns), _lateness(run, epoch_ns)]
    if run.is_flight:
        streams += [_still(run, epoch_ns, notes), _flight(run.measurement, epoch_ns)]
    else:
        notes.append("no flight to show: a bench pattern has no positions")
    with whole_file(path) as file, Writer(file) as writer:
        for time_ns, topic, message in heapq.merge(*streams, key=itemgetter(0)):
            writer.write_message(topic, message, epoch_ns + time_ns, epoch_ns + time_ns)
    return notes


def _still(run: RecordedRun, epoch_ns: int, notes: list[str]) -> Iterator[_Message]:
    """What does not move: the ground and the path, at the first shot."""
    measured = run.measurement
    time_ns = _shot_times_ns(measured)[0]
    yield time_ns, "/path", messages.path_line(epoch_ns + time_ns, measured.position_site_m)
    scene = scene_of(run, notes)
    if scene is not None:
        ground = ground_mesh(scene, extent_of(measured))
        yield time_ns, "/ground", messages.ground_triangles(epoch_ns + time_ns, ground)


def _flight(measured: Measurement, epoch_ns: int) -> Iterator[_Message]:
    """For each shot the vehicle, its beams coloured by range, and its points."""
    valid = measured.range_valid
    rgb = np.zeros((*valid.shape, 3), dtype=np.uint8)
    rgb[valid] = dark_to_bright_rgb(measured.range_m[valid])
    for shot, time_ns in enumerate(_shot_times_ns(measured)):
        at_ns, position_m, beams = (
            epoch_ns + time_ns,
            measured.position_site_m[shot],
            np.flatnonzero(valid[shot]),
        )
        points_m = measured.point_site_m[shot, beams]
        yield time_ns, "/tf", messages.site_from_body(at_ns, position_m, measured.site_from_body[shot])
        yield time_ns, "/beams", messages.beam_lines(at_ns, position_m, points_m, rgb[shot, beams])
        speed_mps = measured.closing_speed_mps[shot, beams]
        cloud = messages.point_cloud(at_ns, points_m, measured.range_m[shot, beams], speed_mps, beams)
        yield time_ns, "/points", cloud


def _values(measured: Measurement, epoch_ns: int) -> Iterator[_Message]:
    """What each beam measured, NaN where invalid."""
    values = beam_values(measured)
    beam_type = messages.numbers_type("Beam", list(values))
    times_ns = measured.time_ns.tolist()
    for shot, time_ns in enumerate(_shot_times_ns(measured)):
        for beam, own_ns in enumerate(times_ns[shot]):
            numbers = {name: float(of_beams[shot, beam]) for name, of_beams in values.items()}
            message = beam_type(timestamp=messages.timestamp(epoch_ns + own_ns), **numbers)
            yield time_ns, f"/beam_{beam}", message


def _lateness(run: RecordedRun, epoch_ns: int) -> Iterator[_Message]:
    if not run.keeps_time:
        return
    lateness_type = messages.numbers_type("Lateness", ["lateness_us"])
    due_ns = run.deliveries.due_ns[run.deliveries.status == DeliveryStatus.SENT]
    for time_ns, late_us in zip(due_ns.tolist(), run.lateness_us.tolist(), strict=True):
        message = lateness_type(timestamp=messages.timestamp(epoch_ns + time_ns), lateness_us=late_us)
        yield time_ns, "/lateness", message


def _events(run: RecordedRun, epoch_ns: int) -> Iterator[_Message]:
    for event in events_of(run):
        yield event.time_ns, "/events", messages.log_line(epoch_ns + event.time_ns, event)


def _shot_times_ns(measured: Measurement) -> list[int]:
    """Time of validity of each shot's first beam."""
    times_ns: list[int] = measured.time_ns[:, 0].tolist()
    return times_ns
