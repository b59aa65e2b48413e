"""The page on Simulink: its table of bytes against packets, and its functions in GNU Octave."""

from __future__ import annotations

import re
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from comparison import FLAGS, SERIAL_STEPS, assert_equal
from waiting import LIMIT_S

from lidar_emu import Measurement, load
from lidar_emu.trajectory.live_datagram import Truth
from lidar_emu.wire import Encoder

REPOSITORY = Path(__file__).resolve().parents[2]
PAGE = (REPOSITORY / "docs" / "simulators.md").read_text()
ROW = re.compile(r"^\| (\d+)( \+ 31 k)? \| (?:(\d) )?`(\w+)` \| (.*?) \| ([\d.]*) ?\|$", re.MULTILINE)
CODES = {"uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "int64": "q", "double": "d"}
OCTAVE = shutil.which("octave-cli")
needs_octave = pytest.mark.skipif(OCTAVE is None, reason="not installed: octave")


@pytest.fixture(scope="module")
def datagrams(tmp_path_factory: pytest.TempPathFactory, simulated: Measurement) -> list[bytes]:
    """The descent with the interface that the page makes, as `--port udp:5601` sends it."""
    interface = tmp_path_factory.mktemp("simulink") / "simulink.toml"
    made = re.search(
        r"^    (sed (?:.*\\\n)+) *protocol/lidar_protocol/default.toml > simulink.toml$", PAGE, re.MULTILINE
    )
    assert made is not None
    default = REPOSITORY / "protocol" / "lidar_protocol" / "default.toml"
    subprocess.run(["bash", "-c", f"{made[1]} '{default}' > '{interface}'"], check=True, timeout=LIMIT_S)
    wire = load("descent.yaml", {"wire.interface": str(interface)}).wire
    encoder = Encoder(wire, can=False, fd=False, beam_count=simulated.beam_count)
    return [packet for packet in encoder.packets(simulated) if isinstance(packet, bytes)]


def value(datagram: bytes, at: int, data_type: str, step: str) -> float | None:
    """A field as the page says; None for the code of a missing value."""
    raw = int(struct.unpack_from(f"<{CODES[data_type]}", datagram, at)[0])
    bits = 8 * struct.calcsize(CODES[data_type])
    missing = (1 << bits) - 1 if data_type.startswith("u") else -(1 << bits - 1)
    return None if raw == missing else raw * float(step)


def test_the_table_has_every_byte_once(datagrams: list[bytes]) -> None:
    places = set[int]()
    for at, of_beam, count, data_type, _, _ in ROW.findall(PAGE):
        size = int(count or 1) * struct.calcsize(CODES[data_type])
        for beam in range(4 if of_beam else 1):
            bytes_of_row = range(int(at) + 31 * beam, int(at) + 31 * beam + size)
            assert places.isdisjoint(bytes_of_row)
            places.update(bytes_of_row)
    assert places == set(range(161))
    assert {len(datagram) for datagram in datagrams} == {161}
    assert {datagram[:6] for datagram in datagrams} == {bytes([26, 207, 252, 29]) + struct.pack("<H", 155)}


def test_the_table_reads_every_value(datagrams: list[bytes], simulated: Measurement) -> None:
    rows: list[dict[str, Any]] = []
    table = {name.strip("`"): (int(at), kind, step) for at, _, _, kind, name, step in ROW.findall(PAGE)}
    (flags_at,) = (int(at) for at, _, _, _, name, _ in ROW.findall(PAGE) if "`fired`" in name)
    reason_at, second_at = (int(at) for at, _, _, _, name, _ in ROW.findall(PAGE) if "reason`" in name)
    for datagram in datagrams:
        for beam in range(4):
            row: dict[str, Any] = {"shot": int(value(datagram, *table["shot"]) or 0), "beam": beam}
            for name in SERIAL_STEPS:
                at, kind, step = table[name]
                row[name] = value(datagram, at + 31 * beam, kind, step)
            flags, codes = datagram[flags_at + 31 * beam], datagram[reason_at + 31 * beam]
            row |= {name: bool(flags >> bit & 1) for bit, name in enumerate(FLAGS)}
            row |= {"reason": codes & 15, "returns": codes >> 4}
            rows.append(row | {"second_reason": datagram[second_at + 31 * beam] >> 4})
    (time_at,) = (int(at) for at, _, _, _, name, _ in ROW.findall(PAGE) if "`time_ns`" in name)
    ticks = [int.from_bytes(datagram[time_at : time_at + 7], "little") for datagram in datagrams]
    np.testing.assert_allclose(np.array(ticks) * 2.0**-24, simulated.time_s[:, 0], rtol=0, atol=2.0**-24)
    assert_equal(rows, simulated, exact=(*FLAGS, "reason", "returns", "second_reason"))


def octave(program: str, folder: Path) -> str:
    """What a program prints that finds the functions of the example."""
    command = [str(OCTAVE), "--norc", "--path", str(REPOSITORY / "examples" / "simulink"), "--eval", program]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=LIMIT_S)
    assert done.returncode == 0, done.stderr
    return done.stdout


@needs_octave
def test_the_function_of_shots(datagrams: list[bytes], simulated: Measurement, tmp_path: Path) -> None:
    (tmp_path / "datagrams").write_bytes(b"".join(datagrams))
    program = """
        bytes = reshape(fread(fopen('datagrams'), Inf, '*uint8'), 161, []);
        for k = 1:columns(bytes)
            [shot, range_m, closing_speed_mps] = lidar_shot(bytes(:, k));
            printf('%d %.3f %.3f %.3f %.3f %.4f %.4f %.4f %.4f\\n', shot, range_m, closing_speed_mps);
        end
    """
    table = np.array([line.split() for line in octave(program, tmp_path).splitlines()], dtype=np.float64)
    np.testing.assert_array_equal(table[:, 0], simulated.shot)
    for columns, name, valid in (
        (slice(1, 5), "range_m", simulated.range_valid),
        (slice(5, 9), "closing_speed_mps", simulated.speed_valid),
    ):
        expected = np.where(valid, getattr(simulated, name), np.nan)
        step = SERIAL_STEPS[name]
        np.testing.assert_allclose(table[:, columns], expected, rtol=0, atol=0.5 * step * (1 + 1e-6))


@needs_octave
def test_the_function_of_truth(tmp_path: Path) -> None:
    program = """
        position_m = [1.5; -2.5; 900];
        velocity_mps = [0.25; -0.5; -40];
        attitude = [0.5; 0.5; -0.5; 0.5];
        bytes = lidar_truth(7, 12.345678901, true, position_m, velocity_mps, attitude, [0.1; -0.2; 0.3]);
        fwrite(fopen('truth', 'w'), bytes);
    """
    octave(program, tmp_path)
    expected = Truth(
        7,
        12_345_678_901,
        (1.5, -2.5, 900),
        (0.25, -0.5, -40),
        None,
        (0.5, 0.5, -0.5, 0.5),
        (0.1, -0.2, 0.3),
        True,
    )
    assert (tmp_path / "truth").read_bytes() == expected.to_bytes()


def test_byte_pack_makes_the_datagram() -> None:
    """The data types of the page, one per row of the table on the datagram: magic to spare, time, five vectors."""
    listed = re.search(r"data types `\{(.*?)\}`", PAGE)
    assert listed is not None
    packed = "".join(CODES[name.strip("'")] for name in listed[1].split(","))
    dimensions = [4, 1, 1, 1, 1, 1, 3, 3, 3, 4, 3]
    layout = struct.Struct(
        "<" + "".join(f"{count}{code}" for count, code in zip(dimensions, packed, strict=True))
    )
    truth = Truth(3, 5, (1, 2, 3), (4, 5, 6), (7, 8, 9), (1, 0, 0, 0), (0.1, 0.2, 0.3), False)
    values = [*b"LETR", 1, 1, 3, 0, 5, 1, 2, 3, 4, 5, 6, 7, 8, 9, 1, 0, 0, 0, 0.1, 0.2, 0.3]
    assert layout.pack(*values) == truth.to_bytes()
