"""The dissector for Wireshark shows what this project's own decoders read, and what was simulated."""

from __future__ import annotations

import random
import shutil
from pathlib import Path
from typing import Any

import pytest
from comparison import assert_equal
from conformance import dissected
from hostile_texts import with_texts
from tshark import Fields, dissect, messages

from lidar_emu import Measurement
from lidar_emu.recording.captures import read_capture
from lidar_icd.example import BEAMS, HEADER
from lidar_protocol import Device, Host, SerialReceiver, default_interface, shipped_interface

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("tshark") is None, reason="not installed: tshark"),
]
SERIAL = "-d", "rtacser.data,lidar_emu"


def rows_of(shots: list[Fields]) -> list[Fields]:
    """A row for each beam."""
    return [
        {"shot": shot["shot"], "beam": number, **values}
        for shot in shots
        for number, values in enumerate(shot["beams"])
    ]


def is_same(shown_value: Any, value: Any) -> bool:
    """Whether a value is what is shown of it, with 15 digits of floating-point numbers."""
    if value is None or shown_value is None:
        return value is shown_value
    return shown_value == value or shown_value == float(f"{value:.15g}")


def assert_same_values(shot: Fields, message: Any) -> None:
    for name, value in message.header.items():
        assert is_same(shot[name], value), name
    assert len(shot["beams"]) == len(message.beams)
    for shown_values, values in zip(shot["beams"], message.beams, strict=True):
        for name, value in values.items():
            assert is_same(shown_values[name], value), name


def test_a_whole_recorded_descent(documents: Path, recorded: Path, simulated: Measurement) -> None:
    found = messages(dissect(documents / "lidar.lua", recorded / "run.pcap", "lidar_emu", *SERIAL))
    assert not [message for message in found if "problem" in message]
    shots = [message for message in found if message["kind"] == "measurement"]
    assert_equal(rows_of(shots), simulated)
    assert len(shots) == len(simulated)
    receiver = SerialReceiver(default_interface())
    stream = [record.data[12:] for record in read_capture(recorded / "run.pcap")]
    decoded = [message for data in stream for message in receiver.receive(data)]
    of_shots = [message for message in decoded if hasattr(message, "beams")]
    for shot, message in zip(shots, of_shots, strict=True):
        assert_same_values(shot, message)
    assert len(found) - len(shots) == len(decoded) - len(of_shots) > 0


def test_datagrams_are_recognised(documents: Path, datagrams: Path, simulated: Measurement) -> None:
    shots = messages(dissect(documents / "lidar.lua", datagrams, "lidar_emu"))
    assert len(shots) == len(simulated)
    assert_equal(rows_of(shots), simulated)


def test_commands_acknowledgements_and_housekeeping(tmp_path: Path) -> None:
    interface = default_interface()
    host, device = Host(interface, 3), Device(interface, 3)
    housekeeping = dict.fromkeys(interface.housekeeping.names, 1)  # type: ignore[union-attr]
    message = interface.commands.messages_by_name["navigation"]  # type: ignore[union-attr]
    solution = dict.fromkeys(message.arguments, 1)
    solution |= {"time_ns": 10**9, "altitude_m": 812.345, "sigma_altitude_m": None}
    records = [
        host.encode_command("set_mode", sequence=7, mode="track"),
        host.encode_command("set_rate_hz", sequence=8, rate_hz=12.5),
        host.encode_command("no_op", sequence=9),
        host.encode_message("navigation", sequence=10, **solution),
        device.acknowledge(1, "set_mode", sequence=7, verdict="out_of_state", time_ns=5 * 10**9),
        device.housekeeping(2, housekeeping | {"temperature_c": None, "time_ns": 10**9}),
    ]
    found = messages(dissected(interface, tmp_path, *records))
    kinds = [message["kind"] for message in found]
    assert kinds == ["command", "command", "command", "command", "acknowledge", "housekeeping"]
    assert {message["unit"] for message in found} == {3}
    assert (found[0]["mode"], found[0]["sequence"]) == (4, 7)
    assert found[1]["rate_hz"] == 12.5
    assert {name: found[3][name] for name in solution} == solution
    assert (found[4]["verdict"], found[4]["time_ns"]) == (4, 5 * 10**9)
    assert found[5]["temperature_c"] is None
    assert found[5]["laser_power_w"] == 1.0


def test_a_flipped_bit_costs_its_own_packet(tmp_path: Path) -> None:
    interface = default_interface()
    frames = [Device(interface).serial_bytes({**HEADER, "shot": shot}, BEAMS) for shot in range(3)]
    damaged = bytearray(frames[1])
    damaged[60] ^= 0x40
    found = messages(dissected(interface, tmp_path, frames[0] + bytes(damaged) + frames[2]))
    assert [message.get("problem") for message in found] == [None, "lidar_emu.bad_crc", None]
    assert [message.get("shot") for message in found] == [0, None, 2]


@pytest.mark.parametrize("name", ["altimeter", "default"])
def test_noise_is_shown_as_such(name: str, tmp_path: Path) -> None:
    """Whatever the bytes are, the dissector neither fails nor shows a message."""
    interface, noise = shipped_interface(name), random.Random(1)
    records = [noise.randbytes(noise.randrange(1, 300)) for _ in range(300)]
    found = messages(dissected(interface, tmp_path, *records))
    assert len(found) > 100
    assert all("problem" in message for message in found)


def test_names_and_texts_cannot_leave_their_strings(tmp_path: Path) -> None:
    interface = with_texts('"]]\n\\ -- end\u0007 $name ${version} \u00e4\u2028 %q')
    frame = Device(interface).serial_bytes(HEADER, BEAMS)
    ((shot,),) = dissected(interface, tmp_path, frame)
    assert shot["shot"] == HEADER["shot"]
