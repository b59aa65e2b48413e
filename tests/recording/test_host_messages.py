"""Messages of the host as arrays: types by the interface, and damaged ones left out."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from lidar_emu.recording.channels import HOST_MESSAGE
from lidar_emu.recording.mcap_file import Damage, RecordedMessage
from lidar_emu.recording.readers import HostMessageReader
from lidar_protocol import default_interface, load
from lidar_protocol.definition_file import files

MORE = """
[host_messages.other]
code = 20
fields = [
    { name = "is_ready", type = "bool" },
    { spare = 7 },
    { name = "count", type = "u8", wraps = true },
    { name = "wide", type = "u64" },
    { name = "level", type = "f32" },
    { name = "flag", beam = 1, type = "bool" },
    { name = "flag", beam = 0, type = "bool" },
]
"""
TEXT = (files("lidar_protocol") / "default.toml").read_text(encoding="utf-8")
DEFINITION = load(TEXT + MORE, "mine.toml").commands.messages_by_name["other"]  # type: ignore[union-attr]
VALUES = {"is_ready": True, "count": 7, "wide": 2**64 - 1, "level": 0.5, "flag_1": True, "flag_0": False}


def message(values: Any, **others: Any) -> RecordedMessage:
    whole = {"message": "other", "sequence": 3, "verdict": "accepted", "arrived_ns": 5, "device_ns": 6}
    data = json.dumps(whole | {"values": values} | others).encode()
    return RecordedMessage(HOST_MESSAGE.topic, 1100, 0, data, 0)


def test_arrays_have_the_types_of_the_fields() -> None:
    reader = HostMessageReader(Damage(), 1000, DEFINITION)
    for each in (
        message(VALUES),
        message({}, verdict="out_of_range"),
        message({"time_ns": 1}, message="navigation"),
        message(VALUES | {"level": 1}, sequence=4),
    ):
        reader.add(each)
    found = reader.messages()
    rows = found.time_ns, found.arrived_ns, found.device_ns, found.sequence
    assert [row.tolist() for row in rows] == [[100, 100], [5, 5], [6, 6], [3, 4]]
    assert {name: (each.dtype, each.tolist()) for name, each in found.values.items()} == {
        "is_ready": (np.bool_, [True, True]),
        "count": (np.int64, [7, 7]),
        "wide": (np.float64, [2.0**64, 2.0**64]),
        "level": (np.float64, [0.5, 1.0]),
        "flag": (np.bool_, [[False, True], [False, True]]),
    }


@pytest.mark.parametrize(
    "damaged",
    [
        message(VALUES | {"count": "7"}),
        message(VALUES | {"count": None}),
        message(VALUES | {"count": 2**63}),
        message(VALUES | {"level": [1.0]}),
        message({"count": 7}),
        message(VALUES | {"more": 1}),
        message(VALUES, sequence=None),
        message(VALUES, arrived_ns=2**70),
    ],
)
def test_a_damaged_message_is_left_out_and_counted(damaged: RecordedMessage) -> None:
    damage = Damage()
    reader = HostMessageReader(damage, 1000, DEFINITION)
    reader.add(damaged)
    assert (len(reader.messages()), damage.to_json()["unreadable"]) == (0, {HOST_MESSAGE.topic: 1})


def test_without_messages_the_arrays_are_empty() -> None:
    definition = default_interface().commands.messages_by_name["navigation"]  # type: ignore[union-attr]
    found = HostMessageReader(Damage(), 0, definition).messages()
    assert (len(found), found.values["altitude_m"].shape, found.values["range_trust"].shape) == (
        0,
        (0,),
        (0, 8),
    )
