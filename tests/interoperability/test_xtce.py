"""The XTCE database keeps the standard's schema; space-packet-parser reads with it what was simulated."""

from __future__ import annotations

import math
import warnings
import xml.etree.ElementTree as ElementTree
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
import space_packet_parser
from comparison import assert_equal
from conformance import Case, cases
from hostile_texts import with_texts
from hypothesis import HealthCheck, given, settings
from space_packet_parser.exceptions import UnrecognizedPacketTypeError
from space_packet_parser.xtce.definitions import XtcePacketDefinition
from space_packet_parser.xtce.validation import validate_xtce

from lidar_emu import Measurement
from lidar_icd import has_xtce, xtce
from lidar_icd.example import BEAMS, HEADER
from lidar_protocol import Device, Host, cobs, default_interface, shipped_interface
from lidar_protocol.definitions import Interface

pytestmark = pytest.mark.slow
SCHEMA = files("space_packet_parser") / "xtce" / "schemas" / "SpaceSystem.xsd"


def definition(interface: Interface, folder: Path) -> XtcePacketDefinition:
    """The interface's database, read by space-packet-parser."""
    path = folder / "lidar.xml"
    path.write_text(xtce(interface), encoding="utf-8")
    assert_valid(path)
    return space_packet_parser.load_xtce(path)


def assert_valid(path: Path) -> None:
    result = validate_xtce(path, level="all", local_xsd=str(SCHEMA))
    assert result.valid, result


def packet_of(frame: bytes) -> bytes:
    """The packet in a frame of the default interface."""
    return cobs.decode(frame.strip(b"\0"))


def value_of(parsed: Any) -> float | None:
    """A value, None where it is NaN."""
    return None if math.isnan(parsed) else parsed


def rows_of(shot: dict[str, Any]) -> list[dict[str, Any]]:
    """A row for each beam, with flags and codes as numbers."""
    names = [name.removesuffix("_0") for name in shot if name.endswith("_0")]
    exact = {"segments", "reason", "returns", "second_reason"}
    rows = []
    for beam in range(int(shot["beam_count"])):
        own = {name: shot[f"{name}_{beam}"] for name in names}
        values = {name: each.raw_value if name in exact else value_of(each) for name, each in own.items()}
        rows.append({"shot": int(shot["shot"]), "beam": beam, **values})
    return rows


def test_a_whole_recorded_descent(documents: Path, recorded: Path, simulated: Measurement) -> None:
    assert_valid(documents / "lidar.xml")
    database = space_packet_parser.load_xtce(documents / "lidar.xml")
    with (recorded / "run.ccsds").open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("error")
        packets = [database.parse_bytes(raw) for raw in space_packet_parser.ccsds_generator(file)]
    shots = [packet for packet in packets if "shot" in packet]
    assert len(shots) == len(simulated)
    assert_equal([row for shot in shots for row in rows_of(shot)], simulated)
    assert [shot["time_ns"] for shot in shots] == pytest.approx(simulated.time_ns[:, 0], rel=0, abs=60)
    housekeeping = [packet for packet in packets if "housekeeping_uptime_s" in packet]
    assert len(shots) + len(housekeeping) == len(packets)
    assert {packet["housekeeping_mode"] for packet in housekeeping[1:]} == {"track"}


def test_acknowledgements_words_and_missing_values(tmp_path: Path) -> None:
    interface = default_interface()
    database, device = definition(interface, tmp_path), Device(interface, 3)
    acknowledge = device.acknowledge(1, "set_mode", sequence=7, verdict="out_of_state", time_ns=5 * 10**9)
    read = database.parse_bytes(packet_of(acknowledge))
    assert (read["acknowledge_verdict"], read["acknowledge_sequence"]) == ("out_of_state", 7)
    assert (read["acknowledge_time_ns"], read["PKT_APID"]) == (5e9, 0x2C3)
    values = dict.fromkeys(interface.housekeeping.names, 1)  # type: ignore[union-attr]
    read = database.parse_bytes(packet_of(device.housekeeping(2, values | {"temperature_c": None})))
    assert math.isnan(read["housekeeping_temperature_c"])
    assert read["housekeeping_laser_power_w"] == 1.0


def test_a_code_without_a_word_is_no_error(tmp_path: Path) -> None:
    database = definition(default_interface(), tmp_path)
    frame = Device(default_interface()).serial_bytes({**HEADER, "mode": 77}, BEAMS)
    assert database.parse_bytes(packet_of(frame))["mode"] == "code_77"


@pytest.mark.parametrize("cut", [1, 32, 33])
def test_a_packet_of_no_whole_number_of_beams_is_refused(cut: int, tmp_path: Path) -> None:
    database = definition(default_interface(), tmp_path)
    packet = bytearray(packet_of(Device(default_interface()).serial_bytes(HEADER, BEAMS))[:-cut])
    packet[4:6] = (len(packet) - 7).to_bytes(2, "big")
    with pytest.raises(UnrecognizedPacketTypeError):
        database.parse_bytes(bytes(packet))


@settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))
@given(case=cases(space_packets=True))
def test_documents_of_any_interface(case: Case, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("any")
    definition(case.interface, folder).parse_bytes(case.interface.link.framing.packet_of(case.frame))


def test_names_and_texts_cannot_leave_their_elements(tmp_path: Path) -> None:
    interface = with_texts("\"]]>&<x a='\\ -->\u0007 \u00e4\u2028 %q")
    read = definition(interface, tmp_path).parse_bytes(
        packet_of(Device(interface).serial_bytes(HEADER, BEAMS))
    )
    assert read["shot"] == HEADER["shot"]


def test_a_solution_of_the_host_is_a_command(tmp_path: Path) -> None:
    interface = default_interface()
    definition(interface, tmp_path)
    root = ElementTree.parse(tmp_path / "lidar.xml").getroot()
    space = {"x": root.tag.partition("}")[0][1:]}
    (meta,) = root.findall(".//x:MetaCommand[@name='navigation']", space)
    types = {each.get("name"): each for each in root.findall(".//x:ArgumentTypeSet/*", space)}
    of_argument = {
        each.get("name"): types[each.get("argumentTypeRef")] for each in meta.findall(".//x:Argument", space)
    }
    message = interface.commands.messages_by_name["navigation"]  # type: ignore[union-attr]
    assert list(of_argument) == ["unit", "sequence", *message.arguments]
    bits = {
        name: int(each.find(".//*[@sizeInBits]/.", space).get("sizeInBits") or 0)  # type: ignore[union-attr]
        for name, each in of_argument.items()
    }
    found = "".join(
        f"{int(entry.get('binaryValue') or '0', 16):0{int(entry.get('sizeInBits') or 0)}b}"
        if "binaryValue" in entry.attrib
        else "x" * bits[entry.get("argumentRef") or ""]
        for entry in meta.findall(".//x:CommandContainer/x:EntryList/*", space)
    )
    sent = packet_of(
        Host(interface).encode_message("navigation", sequence=0, **dict.fromkeys(message.arguments, 1))
    )
    expected = "".join(f"{byte:08b}" for byte in sent[:-2])
    assert len(found) == len(expected)
    assert all(mine in (theirs, "x") for mine, theirs in zip(found, expected, strict=True))


def test_interfaces_that_readers_cannot_read_have_none() -> None:
    assert has_xtce(default_interface())
    assert not has_xtce(shipped_interface("altimeter"))
