"""Read recordings: the resolved run, and arrays of truth, measurements and packets.

recording = read_recording("flight.mcap")
recording.scenario, recording.origin["started_utc"], recording.is_whole
measurement = recording.measurement()  # a `Measurement`, as from `simulate`
packets = recording.packets()
late_us = (packets.sent_ns - packets.due_ns)[packets.status == DeliveryStatus.SENT] / 1e3
"""

from __future__ import annotations

import json
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from lidar_emu.errors import Finding, InputError, warn_once
from lidar_emu.measurement import COLUMNS, Measurement
from lidar_emu.numerics.growing_columns import GrowingColumns
from lidar_emu.recording import channels
from lidar_emu.recording.channels import Channel
from lidar_emu.recording.mcap_file import ALLOWED, Damage, McapFile, RecordedMessage
from lidar_emu.runtime.port.packets import DeliveryStatus
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.transports.spec import PortSpec
from lidar_protocol import DefinitionError, Interface, load

_UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_BLOCK_SHOTS = 1024
_WRONG = (KeyError, TypeError, ValueError, OverflowError)
"""Exceptions for values that are no measurement."""
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


class JsonMessage(NamedTuple):
    """A message of a JSON topic."""

    topic: str
    time_ns: int
    """Scenario time; negative before the flight began."""
    values: dict[str, Any]
    """Fields by the names in `channels`."""


@dataclass(frozen=True)
class Packets:
    """Packets in the order of their due times: arrays are (packets,)."""

    shot: NDArray[np.int64]
    due_ns: NDArray[np.int64]
    """Due time from the start of the run."""
    sent_ns: NDArray[np.int64]
    """Time at which the link had accepted the whole packet, from the start of the run; -1: not sent."""
    status: NDArray[np.int8]
    """Delivery status, a `DeliveryStatus`."""
    overtaken: NDArray[np.bool_]
    """Whether the packet was sent before the device had processed a command that affects its shot."""
    payload: list[bytes]
    """Bytes as on the link, on CAN frame records; empty where suppressed, or too late to be computed."""

    def __len__(self) -> int:
        return len(self.payload)


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
        self._beam_count = 0
        self._lacks = ""
        self.origin: Mapping[str, str] = self._file.metadata("run") or {}
        """Metadata of `provenance`, `port`, `started_utc`, and `waited_ns` if the flight waited for a command."""
        if not self.origin.keys() >= _ORIGIN:
            raise InputError(
                str(path),
                None,
                Finding("not a recording of lidar-emu, or truncated within its header"),
                ALLOWED,
            )
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
            raise InputError(str(self.path), "interface", Finding(str(error)), ALLOWED) from None

    @cached_property
    def port(self) -> PortSpec:
        """Port of the run."""
        return self.of_origin("port_options", lambda text: PortSpec.from_json(json.loads(text)))

    @property
    def started_utc(self) -> datetime:
        """UTC instant of scenario time 0."""
        return self.of_origin("started_utc", datetime.fromisoformat)

    def measurement(self) -> Measurement:
        """Measurements of all shots that were computed, sent or not, without those that are damaged.

        Raises:
            InputError: the recording has no measurement, or those of another version.
        """
        columns = GrowingColumns()
        shots: list[_RecordedShot] = []
        truth: dict[str, Any] = {}
        for message in self._file.messages(channels.TRUTH.topic, channels.MEASUREMENT.topic):
            values = self._values(message)
            if message.topic == channels.TRUTH.topic:
                truth = values
            elif values:
                # One of another shot is the truth of this one only where its own is lost.
                is_its_own = values.get("shot", [])[:1] == [truth.get("shot")]
                shots.append(_RecordedShot(message, values | truth if is_its_own else {}))
            if len(shots) == _BLOCK_SHOTS:
                self._add_block(columns, shots)
                shots.clear()
        self._add_block(columns, shots)
        if not columns.arrays:
            found = (
                f"no column {self._lacks}: made by another version"
                if self._lacks
                else "without a measurement"
            )
            raise InputError(str(self.path), None, Finding(found), "allowed: a recording of this version")
        return Measurement(**columns.arrays)

    def _add_block(self, columns: GrowingColumns, shots: list[_RecordedShot]) -> None:
        """Add the readable shots; the others are counted as damage."""
        if not shots:
            return
        try:
            beams = self._beam_count or len(shots[0].values["fired"])
            columns.add(_measured([shot.values for shot in shots], beams))
            self._beam_count = beams
        except _WRONG:
            for shot in shots:
                self._add_alone(columns, shot)

    def _add_alone(self, columns: GrowingColumns, shot: _RecordedShot) -> None:
        try:
            beams = self._beam_count or len(shot.values["fired"])
            columns.add(_measured([shot.values], beams))
        except _WRONG as error:
            self._lacks = error.args[0] if isinstance(error, KeyError) and shot.values else self._lacks
            self.damage.add_message(shot.message)
            return
        self._beam_count = beams

    def packets(self) -> Packets:
        """All packets that were due, with their delivery status; one whose delivery is damaged is left out."""
        payloads: list[bytes] = []
        rows = array("q")
        packet: RecordedMessage | None = None
        for message in self._file.messages(channels.PACKET.topic, channels.DELIVERY.topic):
            if message.topic == channels.PACKET.topic:
                packet = message
                continue
            delivery = self._checked(message, channels.DELIVERY)
            if delivery is not None and delivery["status"].upper() in DeliveryStatus.__members__:
                sent_ns = -1 if delivery["sent_ns"] is None else delivery["sent_ns"]
                status = DeliveryStatus[delivery["status"].upper()]
                rows.extend((delivery["shot"], delivery["due_ns"], sent_ns, status, delivery["overtaken"]))
                # A packet of another shot is one whose own delivery is lost.
                is_its_own = packet is not None and packet.sequence == message.sequence
                payloads.append(packet.data if packet is not None and is_its_own else b"")
            elif delivery is not None:
                self.damage.add_message(message)
            packet = None
        shot, due_ns, sent_ns, statuses, overtaken = np.array(rows, dtype=np.int64).reshape(-1, 5).T.copy()
        return Packets(shot, due_ns, sent_ns, statuses.astype(np.int8), overtaken.astype(np.bool_), payloads)

    def raw_messages(self, channel: Channel) -> list[RawMessage]:
        """Messages of a raw-bytes topic, such as `channels.HOUSEKEEPING`, in the order in which they were written."""
        messages = self._file.messages(channel.topic)
        return [RawMessage(message.log_time_ns - self.epoch_ns, message.data) for message in messages]

    def json_messages(self, *channels: Channel) -> list[JsonMessage]:
        """Messages of JSON topics, such as `channels.COMMAND`, in the order in which they were written, without
        damaged ones."""
        by_topic = {channel.topic: channel for channel in channels}
        return [
            JsonMessage(message.topic, message.log_time_ns - self.epoch_ns, values)
            for message in self._file.messages(*by_topic)
            if (values := self._checked(message, by_topic[message.topic])) is not None
        ]

    def _checked(self, message: RecordedMessage, channel: Channel) -> dict[str, Any] | None:
        """Values of a message that has all fields of its channel, of their types; None, counted, of another."""
        values = self._values(message)
        if values and channel.describes(values):
            return values
        if values:
            self.damage.add_message(message)
        return None

    def _values(self, message: RecordedMessage) -> dict[str, Any]:
        """Values of a JSON message; none, counted, if it is damaged."""
        try:
            return dict(json.loads(message.data))
        except (ValueError, TypeError, RecursionError):
            self.damage.add_message(message)
            return {}

    def of_origin(self, key: str, read: Callable[[str], _Value]) -> _Value:
        """A value of `origin`, read by a function.

        Raises:
            InputError: it is damaged.
        """
        try:
            return read(self.origin[key])
        except (ValueError, TypeError, KeyError):
            raise InputError(str(self.path), key, Finding("damaged"), ALLOWED) from None

    def _scenario(self) -> FlightScenario | BenchScenario:
        text = self.origin["scenario"]
        stated = self.of_origin("scenario", lambda text: dict(json.loads(text)))
        kind = BenchScenario if "bench_pattern" in stated else FlightScenario
        try:
            return kind.model_validate_json(text)
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(map(str, first["loc"])) or None
            raise InputError(str(self.path), key, Finding(first["msg"]), ALLOWED) from None


class _RecordedShot(NamedTuple):
    message: RecordedMessage
    values: dict[str, Any]


def _measured(shots: list[dict[str, Any]], beams: int) -> dict[str, NDArray[Any]]:
    """Convert shots to arrays, which take a tenth of the memory.

    Raises:
        KeyError, TypeError, ValueError, OverflowError: a shot lacks a column, or its values are no measurement.
    """
    rows: dict[str, list[Any]] = {name: [] for name in COLUMNS}
    point_columns = COLUMNS["point_site_m"].in_rows("point_site_m")
    for values in shots:
        values["point_site_m"] = list(zip(*(values[name] for name in point_columns), strict=True))
        for name, entries in rows.items():
            entries.append(values[name])
    arrays = {name: np.array(rows[name], dtype=column.dtype) for name, column in COLUMNS.items()}
    for name, column in COLUMNS.items():
        if arrays[name].shape != (len(shots), *(() if column.per_shot else (beams,)), *column.components):
            raise ValueError(f"{name} has another shape")
    return arrays


def read_recording(path: str | Path) -> Recording:
    """Open a recording.

    Raises:
        InputError: see `Recording`.
    """
    return Recording(Path(path))
