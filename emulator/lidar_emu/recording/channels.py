"""What a recording holds, topic by topic, with the schemas that stand in the file."""

from __future__ import annotations

import json
from typing import Any, NamedTuple

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
    """A topic. Log times are scenario time on the epoch; those of messages that wait for a packet, its due time."""

    topic: str
    holds: str
    fields: dict[str, _Field] | None = None
    """Of a JSON object, each with its type and meaning; None: the message is bytes as they are."""

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

    def schema_text(self) -> bytes:
        """The same as the file has it."""
        return json.dumps(self.schema()).encode()


_OPTIONAL = ("age_s", "truth_time_ns")
_NUMBER_OF_SHOT = "Number of the shot, from 0, whatever number the device gives it."
_FIRST_SHOT = "The first shot that follows it; null: none does."
_VECTOR = _each(_NUMBER, 3)

TRUTH = Channel(
    "/truth",
    "What was true of a shot. Log time: its first beam's time of validity.",
    {
        "shot": (_INTEGER, _NUMBER_OF_SHOT),
        "position_site_m": (_VECTOR, "Of the vehicle: east, north, up."),
        "velocity_site_mps": (_VECTOR, "Of the vehicle: east, north, up."),
        "true_range_m": (_each(_NUMBER), "Of each beam to the ground; null: there is none."),
        "true_closing_speed_mps": (
            _each(_NUMBER),
            "Of the sensor along each beam, positive toward the ground.",
        ),
        "true_incidence_deg": (_each(_NUMBER), "Between each beam and the ground's normal; null: unknown."),
        "true_in_gap": (_each(_FLAG), "Whether it is bridged: the trajectory's table has a gap there."),
        "age_s": (_NUMBER, "Of live truth: how much older than the shot it was."),
        "truth_time_ns": (_INTEGER, "Of live truth: the scenario time of the newest that was used."),
    },
)
MEASUREMENT = Channel(
    "/measurement",
    "What a shot measured, a list entry per beam: the columns of `simulate --out`. Log time as of /truth.",
    {
        "shot": (_each(_INTEGER), _NUMBER_OF_SHOT),
        "beam": (_each(_INTEGER), "Number of the beam, from 0."),
        "time_s": (_each(_NUMBER), "Time of validity from the epoch; null: the beam did not fire."),
        "time_ns": (_each(_INTEGER), "The same, also of beams that did not fire."),
        "due_ns": (_INTEGER, "When the packet is due, from the epoch, before faults that delay it."),
        "fired": (_each(_FLAG), "Whether the beam fired."),
        "beam_angle_deg": (_each(_NUMBER), "Published angle off boresight."),
        "range_m": (_each(_NUMBER), "Measured range."),
        "closing_speed_mps": (_each(_NUMBER), "Measured closing speed, positive toward the ground."),
        "range_valid": (_each(_FLAG), "Whether the range counts."),
        "speed_valid": (_each(_FLAG), "Whether the closing speed counts."),
        "sign_resolved": (_each(_FLAG), "Whether the closing speed's sign is known."),
        "reason": (_each(_INTEGER), "Why a beam is invalid: code of `lidar_emu.fmcw.reasons.Reason`."),
        "segments": (_each(_INTEGER), "Segments with a detection: bit 0 up, bit 1 constant, bit 2 down."),
        "snr_db": (_each(_NUMBER), "Signal to noise ratio."),
        "residual_mps": (_each(_NUMBER), "Disagreement of the segments, as a speed."),
        "sigma_range_m": (_each(_NUMBER), "Standard deviation that the device states."),
        "sigma_speed_mps": (_each(_NUMBER), "Standard deviation that the device states."),
        "returns": (_each(_INTEGER), "How many returns there were."),
        "second_range_m": (_each(_NUMBER), "Of the second return."),
        "point_east_m": (_each(_NUMBER), "Where the measured range ends along the published beam."),
        "point_north_m": (_each(_NUMBER), "The same, north."),
        "point_up_m": (_each(_NUMBER), "The same, up."),
    },
)
PACKET = Channel(
    "/packet",
    "A shot as it went onto the link, or would have; on CAN as frame records. Log time: when it was due.",
)
FATE = Channel(
    "/fate",
    "What became of a packet. Log time: when it was due.",
    {
        "shot": (_INTEGER, _NUMBER_OF_SHOT),
        "due_ns": (_INTEGER, "From the start of the run."),
        "sent_ns": (
            _INTEGER_OR_NONE,
            "When the link had taken it, from the start of the run; null: it did not.",
        ),
        "fate": (_TEXT, "sent, late, dropped_full, dropped_nobody, dropped_broken or withheld."),
        "overtaken": (_FLAG, "It went out before the device knew of a command that the shot follows."),
    },
)
HOUSEKEEPING = Channel("/housekeeping", "What the device told of itself, as /packet.")
ANSWER = Channel(
    "/answer", "What the device answered to a command, as /packet. Log time: when the command came."
)
COMMAND = Channel(
    "/command",
    "A command from the host. Log time: when it came.",
    {
        "command": (
            {"type": ["string", "integer", "null"]},
            "Name; code of an unknown one; null: unreadable.",
        ),
        "values": (_MAPPING, "Its arguments by name."),
        "sequence": (_INTEGER_OR_NONE, "Its number."),
        "verdict": (_TEXT, "What the device answered."),
        "tone_ns": (_INTEGER_OR_NONE, "Scenario time of the last pulse before it; null: there was none."),
        "first_shot": (_INTEGER_OR_NONE, _FIRST_SHOT),
    },
)
FAULT = Channel(
    "/fault",
    "A fault that acted on a shot. Log time as of /truth.",
    {
        "shot": (_INTEGER, _NUMBER_OF_SHOT),
        "fault": (_INTEGER, "Its place in the scenario's list, those ordered in flight after it."),
        "kind": (_TEXT, "As in a scenario."),
        "beams": (_each(_INTEGER), "Of a fault of beams those on which it acted."),
    },
)
ORDERED_FAULT = Channel(
    "/ordered_fault",
    "A fault ordered in flight. Log time: when its first shot begins.",
    {
        "fault": (_INTEGER, "Its place in the scenario's list."),
        "first_shot": (_INTEGER, "The first shot that has it."),
        "order": (_MAPPING, "The fault as a scenario states it, in scenario time."),
    },
)
LIVE_TRUTH = Channel(
    "/live_truth", "A simulator's datagram that counted, as it came. Log time: when it came."
)
REFUSED_TRUTH = Channel("/refused_truth", "One that was refused. Log time: when it came.")
EVENT = Channel(
    "/event",
    "Something that happened to the link or to one of the run's processes. Log time: when, from the start of the run.",
    {"of": ({"enum": ["link", "process"]}, "What it happened to."), "what": (_TEXT, "What happened.")},
)

CHANNELS = (
    TRUTH, MEASUREMENT, PACKET, FATE, HOUSEKEEPING, ANSWER, COMMAND, FAULT, ORDERED_FAULT, LIVE_TRUTH, REFUSED_TRUTH,
    EVENT,
)  # fmt: skip
"""All of them; each is in every recording, though perhaps without a message."""
