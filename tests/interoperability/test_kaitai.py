"""Code that Kaitai Struct's compiler writes from lidar.ksy, in Python and in C++, reads what was simulated."""

from __future__ import annotations

import binascii
import json
import random
import shutil
import subprocess
import sys
from importlib.resources import files
from pathlib import Path
from typing import Any

import any_interface
import numpy as np
import pytest
from comparison import assert_equal
from hostile_texts import with_texts
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from kaitai import (
    RUNTIME,
    Packet,
    compiled,
    contents,
    read_in_cpp,
    read_in_python,
    require_compiler,
    stream_class,
)
from printed_blocks import ROOT, blocks
from waiting import LIMIT_S

from lidar_emu import Measurement
from lidar_emu.recording.pcap import read_capture
from lidar_icd import kaitai as specification
from lidar_icd.example import BEAMS, HEADER
from lidar_protocol import Device, Host, SerialReceiver, default_interface, load, shipped_interface
from lidar_protocol.definitions import Interface

pytestmark = pytest.mark.slow
HOSTILE = '""" \'\'\' */ \\ \\x \\N{no} \u0007 \u00e4\u2028 #{x} $name\n"""\nraise SystemExit\n"""'


@pytest.fixture(autouse=True)
def _compiler() -> None:
    require_compiler()


@pytest.fixture
def cpp() -> None:
    if shutil.which("c++") is None:
        pytest.skip("not installed: c++")


def stream_of(recorded: Path) -> bytes:
    """The bytes of the serial line."""
    return b"".join(record.data[12:] for record in read_capture(recorded / "run.pcap"))


def assert_are_simulated(packets: list[Packet], simulated: Measurement) -> None:
    shots = [packet for packet in packets if packet.kind == "measurement"]
    assert len(shots) == len(simulated)
    rows = [
        {"shot": shot.values["shot"], "beam": number, **values}
        for shot in shots
        for number, values in enumerate(shot.beams)
    ]
    assert_equal(rows, simulated)
    assert [shot.values["time_ns"] for shot in shots] == pytest.approx(simulated.time_ns[:, 0], rel=0, abs=30)
    housekeeping = [packet for packet in packets if packet.kind == "housekeeping"]
    assert len(housekeeping) > 1
    assert len(shots) + len(housekeeping) == len(packets)
    track = default_interface().enumerations["mode"]["track"]
    assert {packet.values["mode"] for packet in housekeeping[1:]} == {track}


def test_a_whole_recorded_descent_in_python(
    recorded: Path, simulated: Measurement, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interface = default_interface()
    stream = stream_class(interface, tmp_path, monkeypatch)
    found = contents(stream.from_bytes(stream_of(recorded)))
    for content in found:
        assert binascii.crc_hqx(content.bytes[:-2], 0xFFFF) == content.packet.crc
    packets = read_in_python(interface, [content.packet for content in found])
    assert_are_simulated(packets, simulated)
    with stream.SpacePackets.from_file(recorded / "run.ccsds") as of_file:
        assert [each.content.bytes for each in of_file.packets] == [content.bytes for content in found]


@pytest.mark.usefixtures("cpp")
def test_a_whole_recorded_descent_in_cpp(
    recorded: Path, simulated: Measurement, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interface = default_interface()
    packets = read_in_cpp(interface, stream_of(recorded), tmp_path)
    assert_are_simulated(packets, simulated)
    stream = stream_class(interface, tmp_path, monkeypatch)
    found = contents(stream.from_bytes(stream_of(recorded)))
    assert packets == read_in_python(interface, [content.packet for content in found])


def read(interface: Interface, data: bytes, folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[Packet]:
    """Packets in a stream, read in Python."""
    stream = stream_class(interface, folder, monkeypatch).from_bytes(data)
    return read_in_python(interface, [content.packet for content in contents(stream)])


def test_commands_acknowledgements_and_housekeeping(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    interface = default_interface()
    host, device = Host(interface, 3), Device(interface, 3)
    reported = dict.fromkeys(interface.housekeeping.names, 1)  # type: ignore[union-attr]
    data = b"".join(
        [
            host.encode_command("set_mode", sequence=7, mode="track"),
            host.encode_command("set_rate_hz", sequence=8, rate_hz=12.5),
            host.encode_command("no_op", sequence=9),
            device.acknowledge(1, "set_mode", sequence=7, verdict="out_of_state", time_ns=5 * 10**9),
            device.housekeeping(2, reported | {"temperature_c": None, "time_ns": 10**9}),
            device.serial_bytes({**HEADER, "mode": 77}, BEAMS),
        ]
    )
    found = read(interface, data, tmp_path, monkeypatch)
    kinds = [packet.kind for packet in found]
    assert kinds == ["command", "command", "command", "acknowledge", "housekeeping", "measurement"]
    assert {packet.unit for packet in found[:5]} == {3}
    mode, rate, no_op, acknowledge, housekeeping, shot = (packet.values for packet in found)
    assert (mode["command"].name, mode["mode"].name, mode["sequence"]) == ("set_mode", "track", 7)
    assert (rate["rate_hz"], no_op["sequence"]) == (12.5, 9)
    assert (acknowledge["verdict"].name, acknowledge["time_ns"]) == ("out_of_state", 5 * 10**9)
    assert (housekeeping["temperature_c"], housekeeping["laser_power_w"]) == (None, 1.0)
    assert shot["mode"] == 77
    assert found[5].beams[2]["range_m"] is None
    assert found[5].beams[3]["time_offset_s"] is None


def test_a_damaged_frame_costs_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A flipped bit is left to the CRC; a frame is empty without valid stuffing, and where it has not ended."""
    interface = default_interface()
    frames = [Device(interface).serial_bytes({**HEADER, "shot": shot}, BEAMS) for shot in range(4)]
    flipped, cut = bytearray(frames[1]), frames[2][:2] + b"\0" + frames[2][2:]
    flipped[60] ^= 0x40
    data = frames[0] + bytes(flipped) + cut + frames[3] + frames[0][:40]
    found = contents(stream_class(interface, tmp_path, monkeypatch).from_bytes(data))
    intact = [each for each in found if binascii.crc_hqx(each.bytes[:-2], 0xFFFF) == each.packet.crc]
    assert [each.packet.body.shot for each in intact] == [0, 3]


def test_no_flipped_bit_is_an_error_before_the_body_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The CRC alone does not notice all: it does not cover the zero at its end that a flipped bit of stuffing takes."""
    frame = Device(default_interface()).serial_bytes(HEADER, BEAMS)
    stream = stream_class(default_interface(), tmp_path, monkeypatch)
    for bit in range(8, 8 * len(frame) - 8):
        damaged = bytearray(frame)
        damaged[bit // 8] ^= 1 << bit % 8
        for content in contents(stream.from_bytes(bytes(damaged))):
            matches = binascii.crc_hqx(content.bytes[:-2], 0xFFFF) == content.packet.crc
            assert not matches or content.packet.header.kind.name == "unknown"


def test_noise_is_of_an_unknown_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    noise = random.Random(1)
    data = bytes(noise.choice((0, 1, 2, 11, noise.randrange(256))) for _ in range(100_000))
    found = contents(stream_class(default_interface(), tmp_path, monkeypatch).from_bytes(data))
    assert len(found) > 100
    assert {content.packet.header.kind.name for content in found} == {"unknown"}


def test_an_interface_with_a_sync_word_and_the_lowest_byte_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interface = shipped_interface("altimeter")
    beams = [dict.fromkeys(BEAMS[0], 1), {"closing_speed_mps": None, "speed_valid": False}, BEAMS[0]]
    data = Device(interface, 2).serial_bytes({**HEADER, "time_s": 1.5}, beams)
    data += Host(interface, 2).encode_command("set_mode", sequence=3, mode="standby")
    shot, command = read(interface, data, tmp_path, monkeypatch)
    (message,) = SerialReceiver(interface).receive(data)
    of_beams = {f"{name}_{k}": value for k, beam in enumerate(message.beams) for name, value in beam.items()}
    assert shot.values == {**message.header, **of_beams}
    assert (shot.unit, command.unit, command.values["mode"].name) == (2, 2, "standby")


def test_a_cut_off_frame_with_a_sync_word_costs_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interface = shipped_interface("altimeter")
    frame = Host(interface).encode_command("set_mode", sequence=3, mode="standby")
    stream = stream_class(interface, tmp_path, monkeypatch)
    head = interface.link.framing.head(0)
    for length in range(len(frame)):
        first, *others = stream.from_bytes(frame + frame[:length]).frames
        assert first.content.bytes == frame[len(head) :]
        cut = [each.content.bytes for each in others]
        assert cut == ([frame[len(head) : length]] if length >= len(head) else [])


@pytest.mark.usefixtures("cpp")
def test_a_length_below_that_of_the_head_costs_no_other_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A damaged length of a whole frame; its content is empty."""
    definition = (files("lidar_protocol") / "altimeter.toml").read_text(encoding="utf-8")
    of_frame = 'length = "u8"\nlength_counts = "frame"\n'
    interface = load(definition.replace('length = "u8"\n', of_frame), "frame.toml")
    host, head = Host(interface), interface.link.framing.head(0)
    data = host.encode_command("set_mode", sequence=3, mode="standby")
    for length in range(len(head)):
        data += head[:-1] + bytes([length])
    data += host.encode_command("set_mode", sequence=4, mode="standby")
    packets = read(interface, data, tmp_path, monkeypatch)
    assert [packet.values["sequence"] for packet in packets] == [3, 4]
    assert read_in_cpp(interface, data, tmp_path) == packets


def drawn_traffic(drawn: st.DataObject) -> tuple[Interface, bytes, list[tuple[list[Any], dict[str, Any]]]]:
    """An interface, a stream of packets of each kind, and for each block in it the entries and the values given."""
    tree = drawn.draw(any_interface.trees())
    interface = load(any_interface.document(tree), "drawn.toml")
    device, host = Device(interface), Host(interface)
    entries = tree["packet"]["header"], tree["packet"].get("beam", [])
    header, _ = drawn.draw(any_interface.values(entries[0]))
    beams = [drawn.draw(any_interface.values(entries[1]))[0] for _ in range(2)]
    blocks = [(entries[0], dict(header)), *((entries[1], beam) for beam in beams if beam)]
    beams = [{**beam, "range_m": header["range_m_1"]} for beam in beams]
    data = device.serial_bytes(header, beams)
    reported, _ = drawn.draw(any_interface.values(tree["housekeeping"]))
    blocks.append((tree["housekeeping"], reported))
    data += device.housekeeping(70_000, reported)
    given_values = {"sequence": 200, "verdict": 3}
    blocks.append((tree["acknowledge"], given_values))
    data += device.acknowledge(3, "second", **given_values)
    entries_of_command = tree["commands"]["second"]["fields"]
    arguments, _ = drawn.draw(any_interface.values(entries_of_command))
    if None not in arguments.values():
        blocks.append((entries_of_command, arguments))
        data += host.encode_command("second", sequence=255, **arguments)
    return interface, data, blocks


def assert_came_back(packets: list[Packet], blocks: list[tuple[list[Any], dict[str, Any]]]) -> None:
    found = [values for packet in packets for values in (packet.values, *packet.beams)]
    assert len(found) == len(blocks)
    for back, (entries, values) in zip(found, blocks, strict=True):
        for entry in entries:
            if "name" in entry and entry["name"] != "beam_count":
                key = f"{entry['name']}_{entry['beam']}" if "beam" in entry else entry["name"]
                assert any_interface.same(back[key], values[key], entry), entry


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(drawn=st.data())
def test_any_interface_in_python(drawn: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Fields of every kind and width, in both byte orders, behind every framing, header and CRC."""
    interface, data, blocks = drawn_traffic(drawn)
    with pytest.MonkeyPatch.context() as monkeypatch:
        assert_came_back(read(interface, data, tmp_path_factory.mktemp("any"), monkeypatch), blocks)


@pytest.mark.usefixtures("cpp")
@settings(max_examples=4, deadline=None, suppress_health_check=list(HealthCheck))
@given(drawn=st.data())
def test_any_interface_in_cpp(drawn: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Integers of 64 bits, signs of odd widths and offsets survive the types of C++."""
    interface, data, blocks = drawn_traffic(drawn)
    assert_came_back(read_in_cpp(interface, data, tmp_path_factory.mktemp("any")), blocks)


@pytest.mark.usefixtures("cpp")
@pytest.mark.parametrize("order", ["big", "little"])
def test_numbers_that_need_the_widest_types(
    order: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Values that are wrong in C++ where one step of a computation has 32 bits, or no sign."""
    fields: list[dict[str, Any]] = [
        {"name": "shot", "type": "u32", "wraps": True},
        {"name": "time_ns", "type": "cuc"},
        {"name": "below_offset", "type": "u32", "offset": -1000},
        {"name": "limited", "type": "i34", "range": [-3_000_000_000, 3_000_000_000], "none": -(1 << 33)},
        {"name": "bit", "type": "u1", "none": 1},
        {"name": "odd", "type": "i64"},
        {"name": "signed_bit", "type": "i1"},
        {"name": "aligned", "type": "u64", "none": (1 << 64) - 1},
        {"name": "ratio", "type": "u48", "scale": "1e-6"},
    ]
    tree = {
        "interface": {"name": "wide", "version": 1, "units": 1, "byte_order": order, "epoch": "then"},
        "framing": {"kind": "slip"},
        "crc": {"kind": "none"},
        "header": {"kind": "plain", "fields": [{"name": "unit", "type": "u8"}]},
        "packet": {"header": fields},
    }
    interface = load(any_interface.document(tree), "wide.toml")
    low = {"shot": 1, "below_offset": -1000, "limited": -3_000_000_000, "bit": 0, "odd": -(1 << 63)}
    low |= {"signed_bit": -1, "aligned": (1 << 64) - 2, "ratio": 281474976.710655, "time_ns": 4 * 10**18}
    high = {
        "shot": 2,
        "below_offset": 4294966295,
        "limited": 3_000_000_000,
        "bit": None,
        "odd": (1 << 63) - 1,
    }
    high |= {"signed_bit": 0, "aligned": None, "ratio": 1e-6, "time_ns": 0}
    sent = [low, high]
    data = b"".join(Device(interface).serial_bytes(values, [{}]) for values in sent)
    assert [packet.values for packet in read(interface, data, tmp_path, monkeypatch)] == sent
    assert [packet.values for packet in read_in_cpp(interface, data, tmp_path)] == sent


def hostile_interface() -> Interface:
    """The default interface with texts that end comments and strings, and with names that are words of languages."""
    definition = (files("lidar_protocol") / "default.toml").read_text(encoding="utf-8")
    for name, hostile in (("returns", "class"), ("residual_mps", "n_range_m"), ("segments", "int8")):
        assert f'"{name}"' in definition
        definition = definition.replace(f'"{name}"', f'"{hostile}"')
        definition = definition.replace(f"[enumerations.{name}]", f"[enumerations.{hostile}]")
    words = (
        f'"mro" = 7\n"a_b" = 8\n"a b" = 9\n"5" = 10\n"\u00e4" = 11\n"off" = 12\n{json.dumps(HOSTILE)} = 13\n'
    )
    return load(
        definition.replace("[enumerations.mode]\noff = 0", f"[enumerations.mode]\n{words}"), "hostile.toml"
    )


@pytest.mark.parametrize("interface", [with_texts(HOSTILE), hostile_interface()], ids=["texts", "names"])
def test_names_and_texts_cannot_leave_their_places(
    interface: Interface, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    beams = [{**beam, "class": 2, "n_range_m": 0.5, "int8": 3} for beam in BEAMS]
    data = Device(interface).serial_bytes({**HEADER, "mode": 12}, beams)
    (content,) = contents(stream_class(interface, tmp_path, monkeypatch).from_bytes(data))
    assert content.packet.body.shot == HEADER["shot"]
    assert content.packet.body.beams[0].range_m == BEAMS[0]["range_m"]
    if shutil.which("c++"):
        compiled(specification(interface), "cpp_stl", tmp_path)
        syntax = ["c++", "-std=c++11", "-fsyntax-only", f"-I{RUNTIME}", tmp_path / "lidar_stream.cpp"]
        subprocess.run(syntax, check=True, timeout=LIMIT_S)


def test_the_commands_of_the_page(
    documents: Path, recorded: Path, simulated: Measurement, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As printed, with a program of the compiler's name that takes the options of the page."""
    shutil.copytree(documents, tmp_path / "my_interface")
    shutil.copy(recorded / "run.ccsds", tmp_path / "flight.ccsds")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    printed: list[tuple[int, list[float | None]]] = []
    of_kaitai = "run by: tests/interoperability/test_kaitai.py"
    for block in blocks(ROOT / "docs" / "decoders.md"):
        if block.left_out == of_kaitai and block.language == "sh":
            (command,) = block.commands
            name, *options, file = command.split()
            assert (name, options[:3:2]) == ("kaitai-struct-compiler", ["--target", "--outdir"])
            compiled(Path(file).read_text(encoding="utf-8"), options[1], Path(options[3]))
        elif block.left_out == of_kaitai:
            exec(block.text, {"print": lambda *values: printed.append(values)})
    assert [shot for shot, _ in printed] == list(range(len(simulated)))
    ranges = [np.nan if each is None else each for _, of_beams in printed for each in of_beams]
    np.testing.assert_allclose(ranges, simulated.range_m.ravel(), atol=0.0006)
