"""Write a recording with the messages of ROS 2, as MCAP."""

from __future__ import annotations

from pathlib import Path
from typing import Any, BinaryIO

from mcap.writer import Writer

from lidar_emu.files import whole_file
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.viewer import ros2_messages
from lidar_emu.viewer.flight_parts import FlightParts
from lidar_emu.viewer.message_stream import messages_of


def write_ros2(run: RecordedRun, path: Path) -> list[str]:
    """Write the messages of a recording; returns what is missing, with the reasons.

    Raises:
        InputError: the path cannot be written.
        RunError: writing failed.
    """
    notes: list[str] = []
    part = FlightParts(notes, is_running=False).part(run)
    with whole_file(path) as file:
        bag = _Bag(file)
        for time_ns, topic, message in messages_of(part, ros2_messages):
            bag.add(topic, time_ns, message)
        bag.writer.finish()  # type: ignore[no-untyped-call]
    return notes


class _Bag:
    """A file with the profile of ROS 2: messages in CDR, and their definitions."""

    def __init__(self, file: BinaryIO) -> None:
        self.writer = Writer(file)
        self.writer.start(profile="ros2", library="lidar-emu")
        self._channels: dict[str, int] = {}

    def add(self, topic: str, time_ns: int, message: Any) -> None:
        store, kind = ros2_messages.STORE, message.__msgtype__
        if topic not in self._channels:
            definition, _ = store.generate_msgdef(kind, ros_version=2)
            schema = self.writer.register_schema(kind, "ros2msg", definition.encode())
            self._channels[topic] = self.writer.register_channel(topic, "cdr", schema)
        data = bytes(store.serialize_cdr(message, kind))
        self.writer.add_message(self._channels[topic], time_ns, data, time_ns)
