"""The topics of a recording, with the JSON schemas that the file carries."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import orjson

from lidar_emu.measurement import COLUMNS, TABLE
from lidar_emu.numerics.arrays import Column, Group, in_groups
from lidar_emu.recording.mcap_file import Damage, RecordedMessage

_INTEGER = {"type": "integer"}
_INTEGER_OR_NONE = {"type": ["integer", "null"]}
_NUMBER = {"type": ["number", "null"]}
_FLAG = {"type": "boolean"}
_TEXT = {"type": "string"}
_MAPPING = {"type": "object"}


def _each(of: dict[str, Any], length: int | None = None) -> dict[str, Any]:
    exactly = {} if length is None else {"minItems": length, "maxItems": length}
    return {"type": "array", "items": of, **exactly}


_Field = tuple[dict[str, Any], str]


class Channel(NamedTuple):
    """A topic. Log times are scenario time on the epoch; a message about a packet carries the packet's due time."""

    topic: str
    holds: str
    fields: dict[str, _Field] | None = None
    """Type and meaning of each field of a JSON object; None: the message is raw bytes."""

    def schema(self) -> dict[str, Any]:
        """The JSON schema of a message."""
        fields = self.fields or {}
        return {
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            "title": self.topic,
            "description": self.holds,
            "type": "object",
            "properties": {name: kind | {"description": text} for name, (kind, text) in fields.items()},
            "required": [name for name in fields if name not in _OPTIONAL],
            "additionalProperties": False,
        }

    def describes(self, values: dict[str, Any]) -> bool:
        """Whether a message has all fields, of their types; of the items of a list nothing is asked."""
        return all(type(values.get(name, _ABSENT)) in types for name, types in _TYPES[self.topic])


_OPTIONAL = ("age_s", "truth_count")
_PYTHON_TYPES: dict[str, set[type]] = {
    "integer": {int},
    "number": {int, float},
    "boolean": {bool},
    "string": {str},
    "object": {dict},
    "array": {list},
    "null": {type(None)},
}
_ABSENT = object()
_NUMBER_OF_SHOT = "Number of the shot, from 0; the device's own counter may differ."
_FIRST_SHOT = "First shot that the command affects; null: none."


def _recorded(columns: dict[str, Column]) -> dict[str, _Field]:
    return {name: (_kind(column), column.meaning.replace("NaN", "null")) for name, column in columns.items()}


def _kind(column: Column) -> dict[str, Any]:
    kind = _NUMBER if column.is_float else _FLAG if column.dtype == "?" else _INTEGER
    for length in reversed(column.components):
        kind = _each(kind, length)
    return kind if column.per_shot else _each(kind)


TRUE = in_groups(COLUMNS, Group.VEHICLE, Group.TRUTH)
"""Columns of a measurement that `/truth` holds."""
MEASURED = {name: each for name, each in TABLE.items() if each.group not in (Group.VEHICLE, Group.TRUTH)}
"""Columns of the table that `/measurement` holds."""
OF_SHOT = ("time_ns", "due_ns", "pattern")
"""Columns that `/measurement` holds as arrays of a `Measurement`, not as columns of the table."""
TRUTH = Channel(
    "/truth",
    "Ground truth of a shot. Log time: time of validity of its first beam.",
    {
        "shot": (_INTEGER, _NUMBER_OF_SHOT),
        **_recorded(TRUE),
        "age_s": (_NUMBER, "Live truth only: age of the newest sample used, relative to the shot."),
        "truth_count": (_INTEGER, "Live truth only: how many messages of `/live_truth` the shot knows."),
    },
)
MEASUREMENT = Channel(
    "/measurement",
    "Measurements of a shot, a list entry per beam: the columns of `simulate --out`. Log time as in /truth.",
    _recorded(MEASURED | {name: COLUMNS[name] for name in OF_SHOT}),
)
PACKET = Channel(
    "/packet",
    "The packet of a shot, whether or not it was sent; on CAN as frame records. Log time: its due time.",
)
DELIVERY = Channel(
    "/delivery",
    "Delivery status of a packet. Log time: its due time.",
    {
        "shot": (_INTEGER, _NUMBER_OF_SHOT),
        "due_ns": (_INTEGER, "Due time from the start of the run."),
        "sent_ns": (
            _INTEGER_OR_NONE,
            "Time at which the link had accepted the whole packet, from the start of the run; null: not sent.",
        ),
        "status": (
            _TEXT,
            "sent, late, dropped_full, dropped_nobody, dropped_broken, suppressed, held or not_polled.",
        ),
        "overtaken": (
            _FLAG,
            "The packet was sent before the device had processed a command that affects the shot.",
        ),
    },
)
HOUSEKEEPING = Channel(
    "/housekeeping", "A housekeeping packet, bytes as in /packet. Log time: when it was sent."
)
ACKNOWLEDGEMENT = Channel(
    "/acknowledgement",
    "The acknowledgement of a command, bytes as in /packet. Log time: when it was sent.",
)
COMMAND = Channel(
    "/command",
    "A command from the host. Log time: when it arrived.",
    {
        "command": (
            {"type": ["string", "integer", "null"]},
            "Name; code of an unknown command; null: malformed.",
        ),
        "values": (_MAPPING, "Arguments by name."),
        "sequence": (_INTEGER_OR_NONE, "Sequence number."),
        "verdict": (_TEXT, "Verdict of the acknowledgement."),
        "tone_ns": (_INTEGER_OR_NONE, "Scenario time of the last time pulse before the command; null: none."),
        "first_shot": (_INTEGER_OR_NONE, _FIRST_SHOT),
    },
)
HOST_MESSAGE = Channel(
    "/host_message",
    "A message of the host that is no command, such as its navigation solution. Log time: when it arrived.",
    {
        "message": (_TEXT, "Name, as in the interface."),
        "sequence": (_INTEGER_OR_NONE, "Sequence number; null: it ends before that."),
        "verdict": (_TEXT, "accepted, malformed or out_of_range."),
        "values": (_MAPPING, "Fields by key, null for no value; empty unless it is accepted."),
        "arrived_ns": (_INTEGER, "When it arrived, on the monotonic clock of the computer."),
        "device_ns": (_INTEGER, "When it arrived, on the clock of the device."),
    },
)
FAULT = Channel(
    "/fault",
    "A fault that acted on a shot. Log time as in /truth.",
    {
        "shot": (_INTEGER, _NUMBER_OF_SHOT),
        "fault": (
            _INTEGER,
            "Index in the scenario's list of faults; faults injected in flight are appended to it.",
        ),
        "kind": (_TEXT, "Kind of fault, as in a scenario."),
        "beams": (_each(_INTEGER), "Beams on which a beam fault acted; empty for other kinds."),
    },
)
INJECTED_FAULT = Channel(
    "/injected_fault",
    "A fault injected in flight. Log time: start of the first shot that it affects.",
    {
        "fault": (_INTEGER, "Index in the scenario's list of faults."),
        "first_shot": (_INTEGER, "First shot that the fault can affect."),
        "definition": (_MAPPING, "The fault as a scenario states it, with times in scenario time."),
    },
)
LIVE_TRUTH = Channel(
    "/live_truth", "A simulator's datagram that was accepted, unchanged. Log time: when it arrived."
)
REFUSED_TRUTH = Channel(
    "/refused_truth", "A simulator's datagram that was refused, unchanged. Log time: when it arrived."
)
EVENT = Channel(
    "/event",
    "An event on the link or in one of the run's processes. Log time: counted from the start of the run.",
    {"of": ({"enum": ["link", "process", "truth"]}, "Source of the event."), "what": (_TEXT, "Description.")},
)

CHANNELS = (
    TRUTH, MEASUREMENT, PACKET, DELIVERY, HOUSEKEEPING, ACKNOWLEDGEMENT, COMMAND, HOST_MESSAGE, FAULT, INJECTED_FAULT,
    LIVE_TRUTH, REFUSED_TRUTH, EVENT,
)  # fmt: skip
"""All topics. Every recording declares each of them, even without a message."""


def _types(name: str, kind: dict[str, Any]) -> set[type]:
    stated = kind.get("type", list(_PYTHON_TYPES))
    names = [stated] if isinstance(stated, str) else stated
    return set().union(*(_PYTHON_TYPES[each] for each in names), {object} if name in _OPTIONAL else ())


_TYPES = {
    channel.topic: [(name, _types(name, kind)) for name, (kind, _) in (channel.fields or {}).items()]
    for channel in CHANNELS
}


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
