"""Read the shots and packets of a recording from its messages."""

from __future__ import annotations

from array import array
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.errors import Finding, InputError
from lidar_emu.measurement import COLUMNS, Measurement
from lidar_emu.numerics.arrays import Column, Group, GrowingColumns
from lidar_emu.recording import channels
from lidar_emu.recording.channels import checked_values, json_values
from lidar_emu.recording.mcap_file import Damage, RecordedMessage
from lidar_emu.runtime.port.packets import DeliveryStatus
from lidar_protocol.definitions import HostMessageDefinition
from lidar_protocol.fields import Field, Flag, Number, Real

_CODES = {status.name.lower(): status.value for status in DeliveryStatus}


@dataclass(frozen=True)
class Deliveries:
    """Deliveries of packets in the order of their due times: arrays are (packets,)."""

    shot: NDArray[np.int64]
    due_ns: NDArray[np.int64]
    """Due time from the start of the run."""
    sent_ns: NDArray[np.int64]
    """Time at which the link had accepted the whole packet, from the start of the run; -1: not sent."""
    status: NDArray[np.int8]
    """Delivery status, a `DeliveryStatus`."""
    overtaken: NDArray[np.bool_]
    """Whether the packet was sent before the device had processed a command that affects its shot."""

    def __len__(self) -> int:
        return len(self.shot)


@dataclass(frozen=True)
class Packets(Deliveries):
    """Packets with their deliveries."""

    payload: list[bytes]
    """Bytes as on the link, on CAN frame records; empty where suppressed, or too late to be computed."""


class DeliveryReader:
    """Reader of deliveries; one that is damaged is left out.

    Args:
        damage: where messages that cannot be read are counted.
    """

    topics: tuple[str, ...] = (channels.DELIVERY.topic,)

    def __init__(self, damage: Damage) -> None:
        self._damage = damage
        self._rows = array("q")

    def add(self, message: RecordedMessage) -> None:
        """Take a message of these topics, in the order of the file."""
        self._add_delivery(message)

    def deliveries(self) -> Deliveries:
        """The deliveries taken so far."""
        return Deliveries(*self._columns())

    def _add_delivery(self, message: RecordedMessage) -> bool:
        delivery = checked_values(message, channels.DELIVERY, self._damage)
        if delivery is None:
            return False
        sent_ns = -1 if delivery["sent_ns"] is None else delivery["sent_ns"]
        status = _CODES.get(delivery["status"])
        try:
            row = array("q", (delivery["shot"], delivery["due_ns"], sent_ns, status, delivery["overtaken"]))
        except (TypeError, OverflowError):  # an unknown status, or a number beyond 64 bits
            self._damage.add_message(message)
            return False
        self._rows.extend(row)
        return True

    def _columns(
        self,
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int8], NDArray[np.bool_]]:
        rows = np.array(self._rows, dtype=np.int64).reshape(-1, 5)
        shot, due_ns, sent_ns, status, overtaken = rows.T.copy()
        return shot, due_ns, sent_ns, status.astype(np.int8), overtaken.astype(np.bool_)


class PacketReader(DeliveryReader):
    """Reader of packets with their deliveries."""

    topics = (channels.PACKET.topic, channels.DELIVERY.topic)

    def __init__(self, damage: Damage) -> None:
        super().__init__(damage)
        self._payloads: list[bytes] = []
        self._packet: RecordedMessage | None = None

    def add(self, message: RecordedMessage) -> None:
        if message.topic == channels.PACKET.topic:
            self._packet = message
            return
        if self._add_delivery(message):
            # A packet of another shot is one whose own delivery is lost.
            is_its_own = self._packet is not None and self._packet.sequence == message.sequence
            self._payloads.append(self._packet.data if self._packet is not None and is_its_own else b"")
        self._packet = None

    def packets(self) -> Packets:
        """The packets taken so far."""
        return Packets(*self._columns(), self._payloads)


_BLOCK_SHOTS = 256
_WRONG = (KeyError, TypeError, ValueError, OverflowError)
"""Exceptions for values that are no measurement."""
_MESSAGE_COLUMNS = {
    name: tuple(column.in_rows(name)) if column.group is Group.POINT else (name,)
    for name, column in COLUMNS.items()
}
"""The fields of a message that each column holds."""
_FIELDS = {field for fields in _MESSAGE_COLUMNS.values() for field in fields}


class ShotReader:
    """Reader of shots, block by block: as arrays they take a tenth of the memory.

    Args:
        damage: where shots that cannot be read are counted.
        columns: names of the columns to keep, `time_ns` among them; the others have the value of a beam that did
            not fire, and take no memory.
    """

    topics = (channels.TRUTH.topic, channels.MEASUREMENT.topic)

    def __init__(self, damage: Damage, columns: Collection[str] = COLUMNS) -> None:
        self._damage = damage
        self._wanted = {name: column for name, column in COLUMNS.items() if name in columns}
        self._kept = GrowingColumns()
        self._shots: list[_RecordedShot] = []
        self._truth: dict[str, Any] = {}
        self._beams = 0
        self._lacks = ""

    def add(self, message: RecordedMessage) -> None:
        """Take a message of these topics, in the order of the file."""
        values = json_values(message, self._damage)
        if message.topic == channels.TRUTH.topic:
            self._truth = values
        elif values:
            # One of another shot is the truth of this one only where its own is lost.
            is_its_own = values.get("shot", [])[:1] == [self._truth.get("shot")]
            self._shots.append(_RecordedShot(message, values | self._truth if is_its_own else {}))
            if len(self._shots) == _BLOCK_SHOTS:
                self._add_block()

    def measurement(self, path: str) -> Measurement:
        """All shots that were computed, sent or not, without those that are damaged.

        Args:
            path: name of the file, for the error message.

        Raises:
            InputError: there is no measurement, or another version wrote it.
        """
        taken = self.take()
        if taken is None:
            raise self.missing(path)
        return taken

    def missing(self, path: str) -> InputError:
        """The error where no shot can be read: there is none, or another version wrote them.

        Args:
            path: name of the file, for the message.
        """
        lacks = f"no column {self._lacks}: made by another version" if self._lacks else ""
        found = Finding(lacks or "without a measurement")
        return InputError(path, None, found, "must be a recording of this version")

    def take(self) -> Measurement | None:
        """Shots since the last call, without those that are damaged; None if there is none."""
        self._add_block()
        kept, self._kept = self._kept.arrays, GrowingColumns()
        if not kept:
            return None
        shape = kept["time_ns"].shape
        left_out = {
            name: np.broadcast_to(
                np.asarray(column.missing_value, dtype=column.dtype),
                (*(shape[:1] if column.per_shot else shape), *column.components),
            )
            for name, column in COLUMNS.items()
            if name not in kept
        }
        return Measurement(**kept, **left_out)

    def _add_block(self) -> None:
        if not self._shots:
            return
        try:
            self._keep(self._shots)
        except _WRONG:
            for shot in self._shots:
                self._add_alone(shot)
        self._shots.clear()

    def _add_alone(self, shot: _RecordedShot) -> None:
        try:
            self._keep([shot])
        except _WRONG as error:
            self._lacks = error.args[0] if isinstance(error, KeyError) and shot.values else self._lacks
            self._damage.add_message(shot.message)

    def _keep(self, shots: list[_RecordedShot]) -> None:
        values = [shot.values for shot in shots]
        beams = self._beams or len(values[0]["fired"])
        self._kept.add(_arrays(values, self._wanted, beams))
        self._beams = beams


class _RecordedShot(NamedTuple):
    message: RecordedMessage
    values: dict[str, Any]


def _arrays(
    shots: list[dict[str, Any]], wanted: dict[str, Column], beams: int
) -> dict[str, NDArray[np.generic]]:
    """Convert shots to arrays.

    Raises:
        KeyError, TypeError, ValueError, OverflowError: a shot lacks a column, or its values are no measurement.
    """
    for values in shots:
        if not values.keys() >= _FIELDS:
            raise KeyError(min(_FIELDS - values.keys()))
    arrays: dict[str, NDArray[np.generic]] = {}
    for name, column in wanted.items():
        parts = [
            np.array([values[field] for values in shots], dtype=column.dtype)
            for field in _MESSAGE_COLUMNS[name]
        ]
        array = parts[0] if len(parts) == 1 else np.stack(parts, axis=-1)
        if array.shape != (len(shots), *(() if column.per_shot else (beams,)), *column.components):
            raise ValueError(f"{name} has another shape")
        arrays[name] = array
    return arrays


@dataclass(frozen=True)
class HostMessages:
    """Messages of the host of one kind, such as its navigation solutions, in the order of arrival: arrays are
    (messages,), and (messages, beams) for fields of beams."""

    time_ns: NDArray[np.int64]
    """Scenario time of arrival; negative before the flight began."""
    arrived_ns: NDArray[np.int64]
    """Arrival on the monotonic clock of the computer that ran the emulator."""
    device_ns: NDArray[np.int64]
    """Arrival on the clock of the device, which the times of validity in the messages are of."""
    sequence: NDArray[np.int64]
    values: dict[str, NDArray[Any]]
    """Fields by the names of the interface: whole numbers without a code for none are int64, flags bool, all others
    float64, NaN for no value."""

    def __len__(self) -> int:
        return len(self.time_ns)


class HostMessageReader:
    """Reader of the accepted messages of one kind; one that is damaged is left out.

    Args:
        damage: where messages that cannot be read are counted.
        epoch_ns: scenario time 0, nanoseconds since 1970.
        definition: the kind of message.
    """

    topics: tuple[str, ...] = (channels.HOST_MESSAGE.topic,)

    def __init__(self, damage: Damage, epoch_ns: int, definition: HostMessageDefinition) -> None:
        self._damage, self._epoch_ns, self._name = damage, epoch_ns, definition.name
        self._fields = [
            placed.field for placed in definition.packet.placed if placed.field.key in definition.arguments
        ]
        self._whole = {field.key for field in self._fields if _dtype(field) is not np.float64}
        self._rows: list[tuple[int, int, int, int]] = []
        self._columns: dict[str, list[Any]] = {field.key: [] for field in self._fields}

    def add(self, message: RecordedMessage) -> None:
        """Take a message of the topic."""
        values = checked_values(message, channels.HOST_MESSAGE, self._damage)
        if values is None or values["message"] != self._name or values["verdict"] != "accepted":
            return
        row = (
            message.log_time_ns - self._epoch_ns,
            values["arrived_ns"],
            values["device_ns"],
            values["sequence"],
        )
        own = values["values"]
        if own.keys() != self._columns.keys() or not all(map(_is_whole, row)) or not self._are_numbers(own):
            self._damage.add_message(message)
            return
        self._rows.append(row)
        for key, column in self._columns.items():
            column.append(own[key])

    def messages(self) -> HostMessages:
        """The messages."""
        rows = np.array(self._rows, dtype=np.int64).reshape(-1, 4)
        values = {}
        for name in dict.fromkeys(field.name for field in self._fields):
            own = sorted(
                (field for field in self._fields if field.name == name), key=lambda field: field.beam or 0
            )
            columns = [np.array(self._columns[field.key], dtype=_dtype(field)) for field in own]
            values[name] = columns[0] if own[0].beam is None else np.stack(columns, axis=1)
        time_ns, arrived_ns, device_ns, sequence = np.ascontiguousarray(rows.T)
        return HostMessages(time_ns, arrived_ns, device_ns, sequence, values)

    def _are_numbers(self, values: dict[str, Any]) -> bool:
        return all(
            _is_whole(value) if key in self._whole else isinstance(value, int | float | None)
            for key, value in values.items()
        )


def _dtype(field: Field) -> type[Any]:
    codec = field.codec
    if isinstance(codec, Flag):
        return np.bool_
    if isinstance(codec, Real) or codec.bits > 63:
        return np.float64
    if isinstance(codec, Number):
        return np.int64 if codec.whole and codec.none is None else np.float64
    return np.int64


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and -(2**63) <= value < 2**63
