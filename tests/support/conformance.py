"""One table of bytes and the values in them for every decoder: golden.json, and interfaces drawn by chance.

A row has the values of a shot by name, those of beam K with the suffix `_K`; None for no value.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import any_interface
import c_programs
import tshark
from hypothesis import strategies as st

from lidar_emu.recording.captures import RTAC_SERIAL, PcapWriter, serial_record
from lidar_icd import dissector, xtce
from lidar_icd.wireshark import identifier
from lidar_protocol import Device, SerialReceiver, load
from lidar_protocol.definitions import Interface

Row = dict[str, Any]
SHOTS = json.loads((Path(__file__).parents[1] / "protocol" / "golden.json").read_text(encoding="utf-8"))
"""Shots with their bytes on every link, which a script has written with `struct` alone."""


class Case(NamedTuple):
    """A frame of an interface, and what its fields hold."""

    interface: Interface
    frame: bytes
    row: Row
    entries: Mapping[str, Mapping[str, Any]]
    """Definitions of the fields, by the keys of the row."""


def row_of(unit: int, header: Mapping[str, Any], beams: Sequence[Mapping[str, Any]]) -> Row:
    """Row of a shot."""
    of_beams = {f"{name}_{k}": value for k, beam in enumerate(beams) for name, value in beam.items()}
    return {"unit": unit, **header, **of_beams}


@st.composite
def cases(draw: st.DrawFn, space_packets: bool = False) -> Case:
    """Fields of every kind and width behind every framing, header and CRC, or as XTCE can describe them."""
    tree = draw(any_interface.trees())
    if space_packets:
        tree["interface"]["byte_order"] = "big"
        apids = {"measurement": 16, "housekeeping": 32, "acknowledge": 48, "command": 16}
        tree["header"] = {"kind": "ccsds", "apid": apids}
    interface = load(any_interface.document(tree), "drawn.toml")
    of_header, of_beam = tree["packet"]["header"], tree["packet"].get("beam", [])
    header, _ = draw(any_interface.values(of_header))
    beams = [draw(any_interface.values(of_beam))[0] for _ in range(2)]
    unit = draw(st.integers(0, interface.units - 1))
    row = row_of(unit, header, beams)
    row.pop("beam_count", None)
    beams[1]["range_m"] = header.pop("range_m_1")
    named = [entry for entry in of_header if "name" in entry]
    entries = {f"{each['name']}_1" if "beam" in each else each["name"]: each for each in named}
    entries |= {f"{each['name']}_{k}": each for each in of_beam if "name" in each for k in range(2)}
    return Case(interface, Device(interface, unit).serial_bytes(header, beams), row, entries)


def with_python(interface: Interface, folder: Path, *frames: bytes) -> list[Row]:  # noqa: ARG001
    """Rows that the library's receiver reads."""
    messages = SerialReceiver(interface).receive(b"".join(frames))
    return [row_of(message.unit, message.header, message.beams) for message in messages]


def with_c(interface: Interface, folder: Path, *frames: bytes) -> list[Row]:
    """Rows that the generated C header reads."""
    return c_programs.read(folder, interface, b"".join(frames))


def with_wireshark(interface: Interface, folder: Path, *frames: bytes) -> list[Row]:
    """Rows that tshark shows of records on a serial line."""
    (found,) = zip(*dissected(interface, folder, *frames), strict=True)
    return [row_of(shot["unit"], shot, shot["beams"]) for shot in found]


def dissected(interface: Interface, folder: Path, *records: bytes) -> list[list[tshark.Fields]]:
    """What tshark shows of records on a serial line."""
    (folder / "lidar.lua").write_text(dissector(interface), encoding="utf-8")
    path, protocol = folder / "line.pcap", identifier(interface)
    with path.open("wb") as file:
        writer = PcapWriter(file, RTAC_SERIAL)
        for number, data in enumerate(records):
            writer.write(number, serial_record(number, data))
    return tshark.dissect(folder / "lidar.lua", path, protocol, "-d", f"rtacser.data,{protocol}")


def with_xtce(interface: Interface, folder: Path, *frames: bytes) -> list[Row]:
    """Rows that space-packet-parser reads by the generated database."""
    import space_packet_parser

    path = folder / "lidar.xml"
    path.write_text(xtce(interface), encoding="utf-8")
    database = space_packet_parser.load_xtce(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        packets = [database.parse_bytes(interface.link.framing.packet_of(frame)) for frame in frames]
    # The base of the identifiers is a multiple of 16 in every interface here.
    return [
        {"unit": int(packet["PKT_APID"]) % 16} | {key: _xtce_value(value) for key, value in packet.items()}
        for packet in packets
    ]


def with_cosmos(interface: Interface, folder: Path, *frames: bytes) -> list[Row]:
    """Rows that COSMOS reads by plugins of the units, which describe one beam more than was sent."""
    import cosmos

    rows = []
    for frame in frames:
        (message,) = SerialReceiver(interface).receive(frame)
        plugin = cosmos.plugin(interface, folder, message.unit, len(message.beams) + 1)
        (packet,) = plugin.packets([frame])
        rows.append({"unit": message.unit, **plugin.row(packet)})
    return rows


def _xtce_value(parsed: Any) -> Any:
    if isinstance(parsed, str):
        return parsed.raw_value  # type: ignore[attr-defined]
    return None if isinstance(parsed, float) and math.isnan(parsed) else parsed


def assert_golden(rows: Sequence[Row], error: float = 0.0) -> None:
    """Rows of the golden shots, exact but for a tick of the time code and the error of an interpolation."""
    assert len(rows) == len(SHOTS)
    for row, shot in zip(rows, SHOTS, strict=True):
        expected = row_of(shot["unit"], shot["header"], shot["beams"])
        for key, value in expected.items():
            if key in ("time_ns", "due_ns"):
                assert abs(row[key] - value) <= 30, key
            elif value is None:
                assert row[key] is None, key
            else:
                assert math.isclose(row[key], value, rel_tol=1e-14, abs_tol=error), key
        assert f"fired_{len(shot['beams'])}" not in row


def assert_case(row: Row, case: Case, interpolated: bool = False) -> None:
    """The row of a drawn shot, to the digits that the decoder shows; see `_nearly` on interpolated values."""
    assert row["unit"] == case.row["unit"]
    for key, entry in case.entries.items():
        if key in case.row:
            back, value = row[key], case.row[key]
            found = any_interface.same(back, value, entry) or (
                entry["type"] in ("f32", "f64")
                # Wireshark shows 15 digits, which round the largest doubles up to infinity.
                and (math.isclose(back, value, rel_tol=1e-14) or back == float(f"{value:.15g}"))
            )
            assert found or (interpolated and _nearly(back, value, entry)), (entry, back, value)


def _nearly(back: float | None, value: float | None, entry: Mapping[str, Any]) -> bool:
    """Right to the rounding of the largest value of the field; wide codes for no value stay numbers."""
    if "none" not in entry or back is None:
        return False
    if value is None:
        return any_interface.bits_of(entry) > 51 and math.isclose(back, entry["none"], rel_tol=1e-15)
    largest = float(entry.get("scale", 1)) * 2.0 ** any_interface.bits_of(entry) + abs(entry.get("offset", 0))
    return abs(back - value) <= math.ulp(largest)
