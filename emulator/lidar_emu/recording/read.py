"""Read recordings: the resolved run, and arrays of truth, measurements and packets.

recording = read_recording("flight.mcap")
recording.scenario, recording.origin["started_utc"], recording.is_whole
measurement = recording.measurement()  # a `Measurement`, as from `simulate`
packets = recording.packets()
late_us = (packets.sent_ns - packets.due_ns)[packets.status == DeliveryStatus.SENT] / 1e3
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from lidar_emu.errors import Finding, InputError
from lidar_emu.measurement import COLUMNS, Measurement
from lidar_emu.recording import channels
from lidar_emu.recording.channels import Channel
from lidar_emu.recording.mcap_file import ALLOWED, McapFile
from lidar_emu.runtime.port.packets import DeliveryStatus
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.transports.spec import PortSpec
from lidar_protocol import DefinitionError, Interface, load

_UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_BLOCK_SHOTS = 4096


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
        self.origin: Mapping[str, str] = self._file.metadata("run") or {}
        """Metadata of `provenance`, `port`, `started_utc`, and `waited_ns` if the flight waited for a command."""
        if not {"scenario", "interface", "port_options"} <= self.origin.keys():
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
        """Whether the file is complete; known once a topic has been read to the end."""
        return self._file.is_whole

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
        return PortSpec.from_json(json.loads(self.origin["port_options"]))

    @property
    def started_utc(self) -> datetime:
        """UTC instant of scenario time 0."""
        return datetime.fromisoformat(self.origin["started_utc"])

    def measurement(self) -> Measurement:
        """Measurements of all shots that were computed, sent or not.

        Raises:
            InputError: the recording has no measurement.
        """
        blocks: list[Measurement] = []
        shots: list[dict[str, Any]] = []
        truth: dict[str, Any] = {}
        for topic, _, data in self._file.messages(channels.TRUTH.topic, channels.MEASUREMENT.topic):
            values = self._values(data)
            if topic == channels.TRUTH.topic:
                truth = values
                continue
            shots.append(values | truth)
            if len(shots) == _BLOCK_SHOTS:
                blocks.append(self._block(shots))
                shots.clear()
        if shots:
            blocks.append(self._block(shots))
        if not blocks:
            raise InputError(str(self.path), None, Finding("without a measurement"), ALLOWED)
        return Measurement.concatenate(blocks)

    def _block(self, shots: list[dict[str, Any]]) -> Measurement:
        try:
            return _measured(shots)
        except KeyError as error:
            found = Finding(f"no column {error.args[0]}: made by another version")
            raise InputError(str(self.path), None, found, "allowed: a recording of this version") from None

    def packets(self) -> Packets:
        """All packets that were due, with their delivery status."""
        payloads: list[bytes] = []
        rows: list[tuple[int, int, int, int, int]] = []
        payload = b""
        for topic, _, data in self._file.messages(channels.PACKET.topic, channels.DELIVERY.topic):
            if topic == channels.PACKET.topic:
                payload = data
                continue
            delivery = self._values(data)
            sent_ns = -1 if delivery["sent_ns"] is None else delivery["sent_ns"]
            status = DeliveryStatus[delivery["status"].upper()]
            rows.append((delivery["shot"], delivery["due_ns"], sent_ns, status, delivery["overtaken"]))
            payloads.append(payload)
            payload = b""
        shot, due_ns, sent_ns, statuses, overtaken = np.array(rows, dtype=np.int64).reshape(-1, 5).T
        return Packets(shot, due_ns, sent_ns, statuses.astype(np.int8), overtaken.astype(np.bool_), payloads)

    def raw_messages(self, channel: Channel) -> list[RawMessage]:
        """Messages of a raw-bytes topic, such as `channels.HOUSEKEEPING`, in the order in which they were written."""
        messages = self._file.messages(channel.topic)
        return [RawMessage(instant_ns - self.epoch_ns, data) for _, instant_ns, data in messages]

    def json_messages(self, *channels: Channel) -> list[JsonMessage]:
        """Messages of JSON topics, such as `channels.COMMAND`, in the order in which they were written."""
        topics = [channel.topic for channel in channels]
        return [
            JsonMessage(topic, instant_ns - self.epoch_ns, self._values(data))
            for topic, instant_ns, data in self._file.messages(*topics)
        ]

    def _values(self, data: bytes) -> dict[str, Any]:
        try:
            return dict(json.loads(data))
        except (ValueError, TypeError):
            raise InputError(str(self.path), None, Finding("a message that is not JSON"), ALLOWED) from None

    def _scenario(self) -> FlightScenario | BenchScenario:
        text = self.origin["scenario"]
        kind = BenchScenario if "bench_pattern" in self._values(text.encode()) else FlightScenario
        try:
            return kind.model_validate_json(text)
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(map(str, first["loc"])) or None
            raise InputError(str(self.path), key, Finding(first["msg"]), ALLOWED) from None


def _measured(shots: list[dict[str, Any]]) -> Measurement:
    """Convert shots to arrays, which take a tenth of the memory."""
    rows: dict[str, list[Any]] = {name: [] for name in COLUMNS}
    point_columns = COLUMNS["point_site_m"].in_rows("point_site_m")
    for values in shots:
        values["point_site_m"] = list(zip(*(values[name] for name in point_columns), strict=True))
        for name, entries in rows.items():
            entries.append(values[name])
    return Measurement(**{name: np.array(rows[name], dtype=column.dtype) for name, column in COLUMNS.items()})


def read_recording(path: str | Path) -> Recording:
    """Open a recording.

    Raises:
        InputError: see `Recording`.
    """
    return Recording(Path(path))
