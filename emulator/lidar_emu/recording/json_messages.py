"""Read JSON messages of a recording; what cannot be read is counted as damage, nothing is raised."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import orjson

from lidar_emu.recording.channels import Channel
from lidar_emu.recording.mcap_file import Damage, RecordedMessage


class JsonMessage(NamedTuple):
    """A message of a JSON topic."""

    topic: str
    time_ns: int
    """Scenario time; negative before the flight began."""
    values: dict[str, Any]
    """Fields by the names in `channels`."""


def json_values(message: RecordedMessage, damage: Damage) -> dict[str, Any]:
    """Values of a message; none, counted, if it is damaged."""
    try:
        return dict(orjson.loads(message.data))
    except (ValueError, TypeError):
        damage.add_message(message)
        return {}


def checked_values(message: RecordedMessage, channel: Channel, damage: Damage) -> dict[str, Any] | None:
    """Values of a message that has all fields of its channel, of their types; None, counted, of another."""
    values = json_values(message, damage)
    if values and channel.describes(values):
        return values
    if values:
        damage.add_message(message)
    return None


class JsonReader:
    """Reader of whole messages of JSON topics.

    Args:
        damage: where messages that cannot be read are counted.
        epoch_ns: scenario time 0, nanoseconds since 1970.
        channels: the topics.
    """

    def __init__(self, damage: Damage, epoch_ns: int, channels: Iterable[Channel]) -> None:
        self._damage = damage
        self._epoch_ns = epoch_ns
        self._channels = {channel.topic: channel for channel in channels}
        self.topics = tuple(self._channels)
        self.messages: list[JsonMessage] = []
        """The messages, in the order in which they were written, without damaged ones."""

    def add(self, message: RecordedMessage) -> None:
        """Take a message of these topics."""
        values = checked_values(message, self._channels[message.topic], self._damage)
        if values is not None:
            self.messages.append(JsonMessage(message.topic, message.log_time_ns - self._epoch_ns, values))
