"""Write a recording with the schemas of Foxglove, as MCAP."""

from __future__ import annotations

from pathlib import Path

from mcap_protobuf.writer import Writer

from lidar_emu.files import whole_file
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.viewer import foxglove_messages
from lidar_emu.viewer.flight_parts import FlightParts
from lidar_emu.viewer.message_stream import messages_of


def write_foxglove(run: RecordedRun, path: Path) -> list[str]:
    """Write the messages of a recording; returns what is missing, with the reasons.

    Raises:
        InputError: the path cannot be written.
        RunError: writing failed.
    """
    notes: list[str] = []
    part = FlightParts(notes, is_running=False).part(run)
    with whole_file(path) as file, Writer(file) as writer:
        for time_ns, topic, message in messages_of(part, foxglove_messages):
            writer.write_message(topic, message, time_ns, time_ns)
    return notes
