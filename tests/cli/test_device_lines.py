"""What `listen` shows of a device that talks: acknowledgements, and of housekeeping the news."""

from __future__ import annotations

import json
from typing import Any

import pytest

from lidar_emu.cli.messages import DeviceLines
from lidar_emu.transports.frames import Frame
from lidar_emu.transports.messages import Decoder
from lidar_icd.example import values
from lidar_protocol import Device, default_interface

INTERFACE = default_interface()
DEVICE = Device(INTERFACE, unit=3)
assert INTERFACE.housekeeping is not None
QUIET = values(INTERFACE.housekeeping) | {
    "time_ns": 1_500_000_000,
    "mode": "standby",
    "laser_on": False,
    "temperature_c": 20.5,
    "truth_age_s": None,
    "commands_accepted": 0,
}


def received(can: bool, **news: Any) -> list[Any]:
    """Housekeeping as it arrives."""
    reported = QUIET | news
    if not can:
        return list(Decoder(INTERFACE).receive(DEVICE.housekeeping(0, reported)))
    return list(
        Decoder(INTERFACE).receive(Frame(f.can_id, f.data) for f in DEVICE.housekeeping_frames(reported))
    )


def shown(lines: DeviceLines, messages: list[Any]) -> list[str]:
    return [line for message in messages if (line := lines.text_line(message)) is not None]


@pytest.mark.parametrize("can", [False, True])
def test_of_housekeeping_the_first_is_shown_and_then_what_does_not_change_by_itself(can: bool) -> None:
    lines = DeviceLines(INTERFACE)
    first = shown(lines, received(can))
    assert len(first) == (5 if can else 1), "on CAN it comes in frames that stand alone"
    for reported in (
        "mode=standby",
        "laser_on=no",
        "temperature_c=20.5",
        "truth_age_s=none",
        "commands_accepted=0",
    ):
        assert reported in " ".join(first).split(" ")
    assert shown(lines, received(can)) == []
    assert shown(lines, received(can, temperature_c=31.0, uptime_s=99, time_ns=7)) == []
    news = shown(
        lines, received(can, time_ns=2_000_000_000, mode="acquire", laser_on=True, commands_accepted=2)
    )
    begin = "      - s  unit 3" if can else "  2.000 s  unit 3"
    together = [f"{begin} mode=acquire laser_on=yes", f"{begin} commands_accepted=2"]
    assert news == (together if can else [" ".join((together[0], "commands_accepted=2"))])


def test_units_have_news_of_their_own() -> None:
    lines = DeviceLines(INTERFACE)
    shown(lines, received(can=False))
    other = Device(INTERFACE, unit=4).housekeeping(0, QUIET)
    assert len(shown(lines, list(Decoder(INTERFACE).receive(other)))) == 1


@pytest.mark.parametrize("can", [False, True])
def test_an_acknowledgement_is_a_line(can: bool) -> None:
    reported = {"sequence": 9, "verdict": "out_of_range", "time_ns": 1_250_000_000}
    decoder = Decoder(INTERFACE)
    if can:
        frame = DEVICE.acknowledge_frame("set_pattern", **reported)
        messages = decoder.receive([Frame(frame.can_id, frame.data)])
    else:
        messages = decoder.receive(DEVICE.acknowledge(0, "set_pattern", **reported))
    time = "      - s" if can else "  1.250 s"
    assert shown(DeviceLines(INTERFACE), messages) == [f"{time}  unit 3 command set_pattern 9: out of range"]
    assert decoder.counters()["acknowledgements"] == 1
    (message,) = messages
    row = json.loads(DeviceLines(INTERFACE).json_line(message))  # type: ignore[arg-type]
    assert row["unit"] == 3
    expected = {"command": "set_pattern", "sequence": 9, "verdict": "out_of_range"}
    assert {name: row["acknowledge"][name] for name in expected} == expected


def test_housekeeping_as_json_has_every_field_with_words() -> None:
    (message,) = received(can=False)
    row = json.loads(DeviceLines(INTERFACE).json_line(message))
    assert row["unit"] == 3
    reported = row["housekeeping"]
    assert (reported["mode"], reported["laser_on"], reported["temperature_c"], reported["truth_age_s"]) == (
        "standby",
        False,
        20.5,
        None,
    )
    assert set(reported) == INTERFACE.housekeeping.names  # type: ignore[union-attr]
