"""Read recordings: the resolved run, and arrays of truth, measurements and packets.

recording = read_recording("flight.mcap")
recording.scenario, recording.origin["started_utc"], recording.is_whole
measurement = recording.measurement()  # a `Measurement`, as from `simulate`
packets = recording.packets()
late_us = (packets.sent_ns - packets.due_ns)[packets.status == DeliveryStatus.SENT] / 1e3
"""

from __future__ import annotations

import gc
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar

from pydantic import ValidationError

from lidar_emu.errors import Finding, InputError, warn_once
from lidar_emu.files import path_argument
from lidar_emu.measurement import Measurement
from lidar_emu.recording.channels import Channel, JsonMessage, JsonReader
from lidar_emu.recording.mcap_file import NOT_A_RECORDING, Damage, McapFile, ReadPosition, RecordedMessage
from lidar_emu.recording.readers import (
    HostMessageReader,
    HostMessages,
    PacketReader,
    Packets,
    ShotReader,
)
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.transports.spec import PortSpec
from lidar_protocol import DefinitionError, Interface, load

_UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_Value = TypeVar("_Value")
_ORIGIN = {
    "scenario",
    "interface",
    "port",
    "port_options",
    "pace",
    "version",
    "started_utc",
    "build",
    "files_sha256",
}
"""Metadata that every recording has."""


class RawMessage(NamedTuple):
    """A message of a raw-bytes topic: housekeeping, an acknowledgement, a datagram of live truth."""

    time_ns: int
    """Scenario time."""
    payload: bytes
    """Bytes as on the link; on CAN frame records."""


class MessageReader(Protocol):
    """What takes the messages of some topics."""

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics."""

    def add(self, message: RecordedMessage) -> None:
        """Take a message, in the order of the file."""


def mapping_of(text: str) -> dict[str, Any]:
    """Keys and values in JSON; TypeError or ValueError if it is none."""
    return dict(json.loads(text))


class Recording:
    """A recording made by `lidar-emu run --record`, whole or truncated. Arrays are read on demand.

    Args:
        path: file to read.

    Raises:
        InputError: the file cannot be read, is not a recording, or was made by a version with another scenario format.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = McapFile(path)
        self.origin: Mapping[str, str] = self._file.metadata("run") or {}
        """Metadata of `provenance`, `port`, `started_utc`, and `waited_ns` if the flight waited for a command."""
        if not self.origin.keys() >= _ORIGIN:
            found = Finding("not a recording of lidar-emu, or truncated within its header")
            raise InputError(str(path), None, found, NOT_A_RECORDING)
        self.scenario = self._scenario()
        """Scenario of the run, without faults injected in flight."""
        self.epoch_ns = (self.scenario.timing.epoch - _UNIX_EPOCH) // timedelta(microseconds=1) * 1000
        """Scenario time 0 on the instrument's clock, nanoseconds since 1970."""

    @property
    def is_whole(self) -> bool:
        """Whether the file ends with its footer: otherwise the run goes on, or was killed."""
        return self._file.is_whole

    @property
    def damage(self) -> Damage:
        """What could not be read, in the topics that have been read; empty: nothing."""
        return self._file.damage

    def warn_of_damage(self) -> None:
        """Warn, once for each file, if something could not be read."""
        if self.damage:
            warn_once(f"damaged {self.path}", f"{self.path}: damaged: {self.damage}")

    @cached_property
    def interface(self) -> Interface:
        """Interface definition of the packets.

        Raises:
            InputError: this version cannot use the definition.
        """
        try:
            return load(self.origin["interface"], f"{self.path}: interface")
        except DefinitionError as error:
            raise InputError(str(self.path), "interface", Finding(str(error)), NOT_A_RECORDING) from None

    @cached_property
    def port(self) -> PortSpec:
        return self.of_origin("port_options", lambda text: PortSpec.from_json(json.loads(text)))

    @property
    def started_utc(self) -> datetime:
        """UTC instant of scenario time 0."""
        return self.of_origin("started_utc", datetime.fromisoformat)

    def read(self, *readers: MessageReader, since: ReadPosition | None = None) -> None:
        """Pass the messages to the readers of their topics, in one pass over the file.

        Args:
            readers: what takes the messages.
            since: where to begin in a file that is still being written; moved to the end of what was read.
        """
        by_topic = {topic: reader for reader in readers for topic in reader.topics}
        with _without_garbage_collection():
            for message in self._file.messages(*by_topic, since=since):
                by_topic[message.topic].add(message)

    def measurement(self) -> Measurement:
        """Measurements of all shots that were computed, sent or not, without those that are damaged.

        Raises:
            InputError: the recording has no measurement, or those of another version.
        """
        shots = ShotReader(self.damage)
        self.read(shots)
        return shots.measurement(str(self.path))

    def packets(self) -> Packets:
        """All packets that were due, with their delivery status; one whose delivery is damaged is left out."""
        packets = PacketReader(self.damage)
        self.read(packets)
        return packets.packets()

    def raw_messages(self, channel: Channel) -> list[RawMessage]:
        """Messages of a raw-bytes topic, such as `channels.HOUSEKEEPING`, in the order in which they were written."""
        messages = self._file.messages(channel.topic)
        return [RawMessage(message.log_time_ns - self.epoch_ns, message.data) for message in messages]

    def json_messages(self, *channels: Channel) -> list[JsonMessage]:
        """Messages of JSON topics, such as `channels.COMMAND`, in the order in which they were written, without
        damaged ones."""
        messages = JsonReader(self.damage, self.epoch_ns, channels)
        self.read(messages)
        return messages.messages

    def host_messages(self, name: str = "navigation") -> HostMessages:
        """Accepted messages of the host of one kind, such as its navigation solutions.

        Raises:
            InputError: the interface of the recording does not define the message.
        """
        messages = self.host_message_reader(name)
        self.read(messages)
        return messages.messages()

    def host_message_reader(self, name: str = "navigation") -> HostMessageReader:
        """Reader of these messages, for `read`.

        Raises:
            InputError: see `host_messages`.
        """
        known = self.interface.commands.messages_by_name if self.interface.commands else {}
        if name not in known:
            remedy = f"must be a message of the recording's interface: {', '.join(known) or 'it has none'}"
            raise InputError("host_messages", None, name, remedy)
        return HostMessageReader(self.damage, self.epoch_ns, known[name])

    def of_origin(self, key: str, read: Callable[[str], _Value]) -> _Value:
        """A value of `origin`, read by a function.

        Raises:
            InputError: it is damaged.
        """
        try:
            return read(self.origin[key])
        except (ValueError, TypeError, KeyError, RecursionError):
            raise InputError(str(self.path), key, Finding("damaged"), NOT_A_RECORDING) from None

    def _scenario(self) -> FlightScenario | BenchScenario:
        text = self.origin["scenario"]
        stated = self.of_origin("scenario", mapping_of)
        kind = BenchScenario if "bench_pattern" in stated else FlightScenario
        try:
            return kind.model_validate_json(text)
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(map(str, first["loc"])) or None
            raise InputError(str(self.path), key, Finding(first["msg"]), NOT_A_RECORDING) from None


@contextmanager
def _without_garbage_collection() -> Iterator[None]:
    """Lists of numbers hold no cycles, and looking for some takes a quarter of the time of reading."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def read_recording(path: str | Path) -> Recording:
    """Open a recording.

    Raises:
        InputError: no file, not a recording, or damaged.
    """
    return Recording(path_argument("read_recording", "path", path))
