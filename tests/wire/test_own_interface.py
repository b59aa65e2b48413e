"""A scenario with an interface of its own: what it sends, and what is refused before the run."""

from __future__ import annotations

import json
import struct
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import lidar_emu
from lidar_emu.cli import cli
from lidar_emu.errors import InputError
from lidar_emu.measurement import Measurement
from lidar_emu.scenario.load import load
from lidar_emu.scenario.schema import Wire
from lidar_emu.wire import Encoder, interface_named, rows
from lidar_protocol import SerialReceiver, shipped_interface

DEFAULT = (files("lidar_protocol") / "default.toml").read_text()
BENCH = """
name: three beams
wire: {interface: INTERFACE}
bench_pattern:
  duration_s: 0.5
  beams:
    - {range_m: 1000.126, closing_speed_mps: 10}
    - {range_m: 1000, closing_speed_mps: -20.25}
    - {range_m: 1000, closing_speed_mps: 30.5}
"""


def scenario(folder: Path, interface: str) -> Path:
    path = folder / "mine.yaml"
    path.write_text(BENCH.replace("INTERFACE", interface))
    return path


def packets(path: Path) -> tuple[list[bytes], Measurement]:
    loaded = load(path)
    measured = lidar_emu.simulate(loaded)
    encoder = Encoder(loaded.wire, can=False, fd=False, beam_count=measured.beam_count)
    return [bytes(packet) for packet in encoder.packets(measured)], measured  # type: ignore[arg-type]


def test_an_altimeter_sends_what_was_measured(tmp_path: Path) -> None:
    frames, measured = packets(scenario(tmp_path, "altimeter"))
    assert len(frames) == len(measured)
    for k, frame in enumerate(frames):
        assert frame[:5] == b"\x1a\xcf\xfc\x1d\x1c"
        _, sequence, time_s, flags = struct.unpack_from("<BBdB", frame, 5)
        assert (sequence, time_s) == (k % 256, pytest.approx(measured.time_ns[k].min() * 1e-9))
        assert flags == 0b0010_1111, "valid, and in mode track, which is 2 there"
        assert int.from_bytes(frame[16:19], "little") == round(measured.range_m[k, 0] * 100)
        np.testing.assert_array_equal(
            struct.unpack_from("<3f", frame, 19), measured.closing_speed_mps[k].astype("f4")
        )
    shot = SerialReceiver(shipped_interface("altimeter")).receive(frames[3])[0]
    speeds = [row["closing_speed_mps"] for row in rows(shot)]  # type: ignore[arg-type]
    assert speeds == [10, -20.25, 30.5]


def test_a_file_is_relative_to_the_scenario(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(DEFAULT.replace("measurement = 0x2A0", "measurement = 0x123"))
    frames, _ = packets(scenario(tmp_path, "mine.toml"))
    assert frames[0][:4] == b"\x00\x04\x09\x23", "delimiter, code, APID"


def test_the_words_of_an_interface_may_have_other_numbers(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(
        DEFAULT.replace("track = 4", "track = 9").replace("valid = 0", "valid = 11")
    )
    frames, _ = packets(scenario(tmp_path, "mine.toml"))
    (shot,) = SerialReceiver(interface_named(str(tmp_path / "mine.toml"), "test")).receive(frames[0])
    assert (shot.header["mode"], shot.beams[0]["reason"]) == (9, 11)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        (
            'name = "snr_db"',
            'name = "colour"',
            ["packet.beam", "'colour'", "closing_speed_mps", "range_m", "constant"],
        ),
        ('name = "due_ns"\ntype', 'name = "range_m"\ntype', ["can.messages[1].fields[4].name", "'due_ns'"]),
        (
            "[[packet.header]]\nspare = 6",
            '[[packet.header]]\nname = "range_m"\ntype = "u6"',
            ["packet.header", "'range_m'", "clock_locked"],
        ),
        ("track = 4", "tracks = 4", ["enumerations.mode", "no track"]),
        ("units = 16", "units = 0", ["mine.toml: interface.units", "from 1 to 256"]),
        ('over = "packet"', 'over = "frame"', ["mine.toml: crc.over", "packet or body"]),
        ('kind = "cobs"', 'kind = "sync"\nsync = "xyz"', ["mine.toml: framing.sync", "'xyz'", "hexadecimal"]),
        ('kind = "crc16_ccitt_false"', 'kind = "crc16"', ["mine.toml: crc.kind", "'crc16'", "crc16_modbus"]),
    ],
)
def test_what_cannot_be_sent_is_refused_before_the_run(
    tmp_path: Path, old: str, new: str, reported: list[str]
) -> None:
    assert old in DEFAULT
    (tmp_path / "mine.toml").write_text(DEFAULT.replace(old, new, 1))
    loaded = load(scenario(tmp_path, "mine.toml"))
    with pytest.raises(InputError) as caught:
        Encoder(loaded.wire, can=False, fd=False, beam_count=3)
    for part in reported:
        assert part in str(caught.value)


@pytest.mark.parametrize(
    ("wire", "can", "beams", "reported"),
    [
        (Wire(interface="altimeter", unit=4), False, 3, ["wire.unit: must be 0 to 3", "(got 4)"]),
        (Wire(interface="altimeter"), True, 3, ["altimeter: can: missing", "byte link"]),
        (Wire(interface="/nowhere/my.toml"), False, 3, ["/nowhere/my.toml", "no such file"]),
    ],
)
def test_what_does_not_fit_is_refused(wire: Wire, can: bool, beams: int, reported: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        Encoder(wire, can=can, fd=False, beam_count=beams)
    for part in reported:
        assert part in str(caught.value)


def test_a_run_listens_to_itself_with_the_same_interface(tmp_path: Path) -> None:
    path = str(scenario(tmp_path, "altimeter"))
    done = CliRunner().invoke(cli, ["run", path, "--pace", "max", "--json"], catch_exceptions=False)
    ready, reported = map(json.loads, done.stdout.splitlines())
    assert ready == {"ready": {"port": "in-memory loopback"}}
    assert reported["shots"]["sent"] == 10
    assert reported["far_end"]["messages"] == 10 + reported["housekeeping"]["sent"] == 11
    assert reported["far_end"]["skipped_bytes"] == 0


def test_the_documents_of_any_interface(tmp_path: Path) -> None:
    arguments = ["icd", "--interface", "altimeter", "--out", str(tmp_path)]
    done = CliRunner().invoke(cli, arguments, catch_exceptions=False)
    assert done.exit_code == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "INTERFACE.md",
        "cosmos",
        "lidar.h",
        "lidar.lua",
    ]
    assert "CRC-16/MODBUS" in (tmp_path / "INTERFACE.md").read_text()
