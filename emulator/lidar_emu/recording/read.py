"""Recordings read back: the run as it was resolved, and arrays of truth, measurements and packets.

recording = read_recording("flight.mcap")
recording.scenario, recording.origin["started_utc"], recording.is_whole
measurement = recording.measurement()  # a `Measurement`: all that is done with one from `simulate` can be done
packets = recording.packets()
late_us = (packets.sent_ns - packets.due_ns)[packets.fate == Fate.SENT] / 1e3
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import UTC, datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from lidar_emu.errors import Finding, InputError
from lidar_emu.measurement import Measurement
from lidar_emu.recording import channels
from lidar_emu.recording.channels import Channel
from lidar_emu.recording.mcap_file import ALLOWED, McapFile
from lidar_emu.runtime.port.packets import Fate
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.transports.spec import PortSpec
from lidar_protocol import DefinitionError, Interface, load

_UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_BLOCK_SHOTS = 4096
_POINT = ("point_east_m", "point_north_m", "point_up_m")


class Said(NamedTuple):
    """Something that the device said between shots."""

    time_ns: int
    """Scenario time."""
    payload: bytes
    """As on the link; on CAN as frame records."""


class Told(NamedTuple):
    """A JSON message."""

    topic: str
    time_ns: int
    """Scenario time, negative before it began."""
    values: dict[str, Any]
    """As `channels` has them."""


@dataclass(frozen=True)
class Packets:
    """What was due, in order: arrays are (packets,)."""

    shot: NDArray[np.int64]
    due_ns: NDArray[np.int64]
    """From the start of the run."""
    sent_ns: NDArray[np.int64]
    """When the link had taken it, from the start of the run; -1 if it did not."""
    fate: NDArray[np.int8]
    """A `Fate` each."""
    overtaken: NDArray[np.bool_]
    """Which went out before the device knew of a command that their shots follow."""
    payload: list[bytes]
    """As on the link, on CAN as frame records; empty where it was withheld, or too late to be computed."""

    def __len__(self) -> int:
        return len(self.payload)


class Recording:
    """A file of `lidar-emu run --record`, also one that was cut short. Arrays are read when they are asked for.

    Args:
        path: of the file.

    Raises:
        InputError: it cannot be read, is no recording, or one of a version whose scenario this one does not know.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = McapFile(path)
        self.origin: Mapping[str, str] = self._file.metadata("run") or {}
        """What `provenance` says, with `port` and `started_utc`; `waited_ns` of a flight that waited for a command."""
        if not {"scenario", "interface", "port_options"} <= self.origin.keys():
            raise InputError(
                str(path), None, Finding("no recording of lidar-emu, or cut within its head"), ALLOWED
            )
        self.scenario = self._scenario()
        """What was flown, without faults ordered in flight."""
        self.epoch_ns = (self.scenario.timing.epoch - _UNIX_EPOCH) // timedelta(microseconds=1) * 1000
        """Scenario time 0 on the instrument's clock, since 1970."""

    @property
    def is_whole(self) -> bool:
        """Whether the file ends as it should; known once something has been read to its end."""
        return self._file.is_whole

    @cached_property
    def interface(self) -> Interface:
        """By which packets were made.

        Raises:
            InputError: this version does not understand it.
        """
        try:
            return load(self.origin["interface"], f"{self.path}: interface")
        except DefinitionError as error:
            raise InputError(str(self.path), "interface", Finding(str(error)), ALLOWED) from None

    @cached_property
    def port(self) -> PortSpec:
        """Where it was sent."""
        return PortSpec.from_json(json.loads(self.origin["port_options"]))

    @property
    def started_utc(self) -> datetime:
        """When scenario time 0 was."""
        return datetime.fromisoformat(self.origin["started_utc"])

    def measurement(self) -> Measurement:
        """All shots that were computed, sent or not.

        Raises:
            InputError: there is none.
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
                blocks.append(_measured(shots))
                shots.clear()
        if shots:
            blocks.append(_measured(shots))
        if not blocks:
            raise InputError(str(self.path), None, Finding("without a measurement"), ALLOWED)
        return Measurement.joined(blocks)

    def packets(self) -> Packets:
        """All packets that were due."""
        payloads: list[bytes] = []
        rows: list[tuple[int, int, int, int, int]] = []
        payload = b""
        for topic, _, data in self._file.messages(channels.PACKET.topic, channels.FATE.topic):
            if topic == channels.PACKET.topic:
                payload = data
                continue
            told = self._values(data)
            sent_ns = -1 if told["sent_ns"] is None else told["sent_ns"]
            rows.append(
                (told["shot"], told["due_ns"], sent_ns, Fate[told["fate"].upper()], told["overtaken"])
            )
            payloads.append(payload)
            payload = b""
        shot, due_ns, sent_ns, fate, overtaken = np.array(rows, dtype=np.int64).reshape(-1, 5).T
        return Packets(shot, due_ns, sent_ns, fate.astype(np.int8), overtaken.astype(np.bool_), payloads)

    def said(self, channel: Channel) -> list[Said]:
        """Messages of a channel of bytes, such as `channels.HOUSEKEEPING`."""
        messages = self._file.messages(channel.topic)
        return [Said(instant_ns - self.epoch_ns, data) for _, instant_ns, data in messages]

    def told(self, *of: Channel) -> list[Told]:
        """Messages of channels of JSON, such as `channels.COMMAND`, in the order in which they were written."""
        topics = [channel.topic for channel in of]
        return [
            Told(topic, instant_ns - self.epoch_ns, self._values(data))
            for topic, instant_ns, data in self._file.messages(*topics)
        ]

    def _values(self, data: bytes) -> dict[str, Any]:
        try:
            return dict(json.loads(data))
        except (ValueError, TypeError):
            raise InputError(str(self.path), None, Finding("a message that is no JSON"), ALLOWED) from None

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
    """Shots as arrays, which take a tenth of the memory."""
    columns: dict[str, list[Any]] = {f.name: [] for f in fields(Measurement)}
    for values in shots:
        values["point_site_m"] = list(zip(*(values[name] for name in _POINT), strict=True))
        for name, rows in columns.items():
            rows.append(values[name])
    return Measurement(
        **{name: np.array(rows, dtype=_KINDS.get(name, np.float64)) for name, rows in columns.items()}
    )


def read_recording(path: str | Path) -> Recording:
    """A recording.

    Raises:
        InputError: see `Recording`.
    """
    return Recording(Path(path))


_KINDS: dict[str, Any] = {
    **dict.fromkeys(("shot", "time_ns", "due_ns"), np.int64),
    **dict.fromkeys(("fired", "range_valid", "speed_valid", "sign_resolved", "true_in_gap"), np.bool_),
    **dict.fromkeys(("segments", "returns"), np.uint8),
    "reason": np.int8,
}
