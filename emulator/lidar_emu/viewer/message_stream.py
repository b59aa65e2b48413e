"""A recorded flight as messages of ROS 2 over time."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer

from lidar_emu.files import whole_file
from lidar_emu.measurement import Measurement
from lidar_emu.report.exports import dark_to_bright_rgb
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.runtime.port.packets import DeliveryStatus
from lidar_emu.viewer import ros2_messages
from lidar_emu.viewer.flight_parts import Event, FlightPart, FlightParts, beam_values
from lidar_emu.viewer.layouts import LATENESS
from lidar_emu.viewer.ros2_messages import encoded, schema_of

_PATH, _GROUND = "/path", "/ground"
STANDING = (_PATH, _GROUND)
"""Topics whose last message stands until the next."""
_WIDTH_SHARE = 0.007
"""Width of beams, as a share of the longest of their shot: narrower ones vanish where the whole flight is in view."""
_AGAIN_NS = 10**9
"""Foxglove Studio forgets, when one starts to play a file, what it drew of the first 0.1 s."""
_Messages = Iterator[tuple[int, str, Any]]
"""Nanoseconds since 1970, topic, message."""


def messages_of(part: FlightPart) -> _Messages:
    """Yield the messages of a part of a recording in the order of their times.

    The times are those of the recording's own topics: scenario time on the scenario's epoch.
    """
    run = part.run
    epoch_ns, measured = run.recording.epoch_ns, run.measurement
    parts = [_values(measured, beam, epoch_ns) for beam in range(measured.beam_count)]
    parts += [_lateness(run, epoch_ns), _events(part.events, epoch_ns)]
    if run.is_flight:
        parts += [_still(part, epoch_ns), _flight(part, epoch_ns)]
    return heapq.merge(*parts, key=itemgetter(0))


def _still(part: FlightPart, epoch_ns: int) -> _Messages:
    """What does not move: the ground and the path, at the first shot, and once again."""
    times_ns = _times_ns(part.run.measurement, 0, epoch_ns)
    again = (time_ns for time_ns in times_ns if time_ns >= times_ns[0] + _AGAIN_NS)
    for time_ns in (times_ns[0], *islice(again, 1)):
        if part.path_site_m is not None:
            yield time_ns, _PATH, ros2_messages.path(time_ns, part.path_site_m)
        if part.ground is not None:
            yield time_ns, _GROUND, ros2_messages.ground(time_ns, part.ground)


def _flight(part: FlightPart, epoch_ns: int) -> _Messages:
    measured = part.run.measurement
    valid = measured.range_valid
    rgb = np.zeros((*valid.shape, 3), dtype=np.uint8)
    rgb[valid] = dark_to_bright_rgb(measured.range_m[valid], part.range_span_m)
    for shot, time_ns in enumerate(_times_ns(measured, 0, epoch_ns)):
        position_m, beams = measured.position_site_m[shot], np.flatnonzero(valid[shot])
        points_m, speed_mps = measured.point_site_m[shot, beams], measured.closing_speed_mps[shot, beams]
        yield time_ns, "/tf", ros2_messages.vehicle(time_ns, position_m, measured.site_from_body[shot])
        range_m = measured.range_m[shot, beams]
        width_m = _WIDTH_SHARE * float(range_m.max(initial=0.0))
        lines = ros2_messages.beams(time_ns, position_m, points_m, rgb[shot, beams], width_m)
        yield time_ns, "/beams", lines
        yield time_ns, "/points", ros2_messages.points(time_ns, points_m, range_m, speed_mps, beams)


def _values(measured: Measurement, beam: int, epoch_ns: int) -> _Messages:
    values = {name: of_beams[:, beam].tolist() for name, of_beams in beam_values(measured).items()}
    for shot, time_ns in enumerate(_times_ns(measured, beam, epoch_ns)):
        for name, column in values.items():
            yield time_ns, f"/beam_{beam}/{name}", ros2_messages.number(column[shot])


def _lateness(run: RecordedRun, epoch_ns: int) -> _Messages:
    if not run.keeps_time:
        return
    due_ns = run.deliveries.due_ns[run.deliveries.status == DeliveryStatus.SENT]
    for time_ns, late_us in zip(due_ns.tolist(), run.lateness_us.tolist(), strict=True):
        yield epoch_ns + time_ns, f"/lateness/{LATENESS}", ros2_messages.number(late_us)


def _events(events: list[Event], epoch_ns: int) -> _Messages:
    for event in events:
        time_ns = epoch_ns + event.time_ns
        yield time_ns, "/events", ros2_messages.event(time_ns, event)


def _times_ns(measured: Measurement, beam: int, epoch_ns: int) -> list[int]:
    """Times of validity of a beam; those of beam 0 stand for the shots."""
    times_ns: list[int] = (epoch_ns + measured.time_ns[:, beam]).tolist()
    return times_ns


def write_ros2(run: RecordedRun, path: Path) -> list[str]:
    """Write the messages of a recording; returns what is missing, with the reasons.

    Raises:
        InputError: the path cannot be written.
        RunError: writing failed.
    """
    notes: list[str] = []
    part = FlightParts(notes, is_running=False).part(run)
    channels: dict[str, int] = {}
    with whole_file(path) as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="lidar-emu")
        for time_ns, topic, message in messages_of(part):
            if topic not in channels:
                kind, definition = schema_of(message)
                schema = writer.register_schema(kind, "ros2msg", definition)
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], time_ns, encoded(message), time_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return notes
