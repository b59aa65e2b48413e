"""Every decoder of an interface reads the values of one table: Python, C, Wireshark, XTCE, COSMOS and DBC."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cantools
import pytest
import tshark
from c_programs import NEEDS_COMPILER
from cantools.database.can import Database
from conformance import (
    SHOTS,
    Row,
    assert_case,
    assert_golden,
    cases,
    with_c,
    with_cosmos,
    with_python,
    with_wireshark,
    with_xtce,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import lidar_icd
from lidar_emu.recording.captures import SOCKETCAN, PcapWriter, can_record
from lidar_emu.transports.frames import Frame
from lidar_protocol import default_interface
from lidar_protocol.definitions import Interface

Decode = Callable[..., list[Row]]
NEEDS_TSHARK = pytest.mark.skipif(shutil.which("tshark") is None, reason="not installed: tshark")
DECODERS = [
    pytest.param(with_python, id="python"),
    pytest.param(with_c, id="c", marks=NEEDS_COMPILER),
    pytest.param(with_wireshark, id="wireshark", marks=[NEEDS_TSHARK, pytest.mark.slow]),
    pytest.param(with_xtce, id="xtce", marks=pytest.mark.slow),
    pytest.param(with_cosmos, id="cosmos", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("decode", DECODERS)
def test_golden_packets(decode: Decode, tmp_path: Path) -> None:
    frames = [bytes.fromhex(shot["frame"]) for shot in SHOTS]
    assert_golden(decode(default_interface(), tmp_path, *frames), 1e-9 if decode is with_xtce else 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("decode", DECODERS)
@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(drawn=st.data())
def test_any_interface(
    decode: Decode, drawn: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Fields of every kind and width, in both byte orders, behind every framing, header and CRC."""
    case = drawn.draw(cases(space_packets=decode is with_xtce))
    (row,) = decode(case.interface, tmp_path_factory.mktemp("any"), case.frame)
    assert_case(row, case, interpolated=decode is with_xtce)


def by_dbc(interface: Interface, folder: Path, frames: list[Frame]) -> list[Row]:  # noqa: ARG001
    """Values by cantools with the DBC alone, which has the identifiers of unit 0."""
    database = cantools.database.load_string(lidar_icd.dbc(interface), "dbc", strict=True)
    assert isinstance(database, Database)
    rows = []
    for frame in frames:
        message = database.get_message_by_frame_id(0x100 + frame.can_id % 0x40)
        assert message.is_fd == frame.is_fd
        words, numbers = message.decode(frame.data), message.decode(frame.data, decode_choices=False)
        assert isinstance(words, dict)
        assert isinstance(numbers, dict)
        assert message.encode(numbers) == frame.data
        missing = {name for name, word in words.items() if str(word) in ("none", "absent")}
        row = numbers | dict.fromkeys(missing - {"segments", "reason", "returns"})
        for name in ("time", "due"):
            if f"{name}_seconds" in row:
                row[f"{name}_ns"] = round(1e9 * (row[f"{name}_seconds"] + row[f"{name}_fraction"]))
        rows.append(row)
    return rows


def by_wireshark(interface: Interface, folder: Path, frames: list[Frame]) -> list[Row]:
    """Values that tshark shows of a bus."""
    (folder / "lidar.lua").write_text(lidar_icd.dissector(interface), encoding="utf-8")
    with (folder / "bus.pcap").open("wb") as file:
        writer = PcapWriter(file, SOCKETCAN)
        for number, frame in enumerate(frames):
            writer.write(number, can_record(frame))
    return tshark.messages(tshark.dissect(folder / "lidar.lua", folder / "bus.pcap", "lidar_emu_can"))


def by_layout(interface: Interface, folder: Path, frames: list[Frame]) -> list[Row]:  # noqa: ARG001
    """Values by the library's layout of each message."""
    can = interface.can
    assert can is not None
    layouts = {can.can_id(0, each) + slot: each.layout for each in can.messages for slot in range(can.beam_slots)
               if slot == 0 or each.each_beam}  # fmt: skip
    return [layouts[0x100 + frame.can_id % 0x40].unpack(frame.data) for frame in frames]


def given_values(shot: Mapping[str, Any], can_id: int) -> dict[str, Any]:
    """Values of the golden shot that a frame may have: those of its beam, or of its header."""
    slot = can_id % 0x40
    if slot in (0, 1, 2, 0x20):
        return {
            **shot["header"],
            "beam_count": len(shot["beams"]),
            "shot_counter": shot["header"]["shot"] % 16,
        }
    return {**shot["beams"][slot % 8], "shot_counter": shot["header"]["shot"] % 16}


@pytest.mark.parametrize(
    "decode", [by_layout, by_dbc, pytest.param(by_wireshark, marks=[NEEDS_TSHARK, pytest.mark.slow])]
)
@pytest.mark.parametrize("can_set", ["core", "full", "fd"])
def test_golden_frames_on_can(decode: Callable[..., list[Row]], can_set: str, tmp_path: Path) -> None:
    """SNR is in steps of 1 dB in the core set."""
    for shot in SHOTS:
        frames = [
            Frame(can_id, bytes.fromhex(data), can_set == "fd") for can_id, data in shot["can"][can_set]
        ]
        rows = decode(default_interface(), tmp_path, frames)
        for frame, row in zip(frames, rows, strict=True):
            expected = given_values(shot, frame.can_id)
            shared = expected.keys() & row.keys()
            assert len(shared) > 1
            for name in shared:
                value, found = expected[name], row[name]
                if value is None:
                    assert found is None, name
                else:
                    error = {"snr_db": 0.5, "time_ns": 60, "due_ns": 60}.get(name, 1e-9)
                    assert abs(float(found) - float(value)) <= error, name
