"""Write a recording with the messages of ROS 2, as MCAP."""

from __future__ import annotations

from pathlib import Path

from mcap.writer import Writer

from lidar_emu.files import whole_file
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.viewer.flight_parts import FlightParts
from lidar_emu.viewer.message_stream import messages_of
from lidar_emu.viewer.ros2_messages import encoded, schema_of


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
