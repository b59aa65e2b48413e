"""The same bytes through other people's decoders, and through one built from the interface document alone."""

import re
import struct
from pathlib import Path

import cantools
import pytest

import lidar_icd
import lidar_protocol
from lidar_emu.cli.documents import interface_document
from lidar_emu.runtime.command_handler import RateLimiter
from lidar_emu.scenario.load import load
from lidar_emu.transports.spec import (
    DEFAULT_BAUD,
    DEFAULT_BITRATE,
    DEFAULT_DATA_BITRATE,
)
from lidar_icd import example
from lidar_protocol import Device, default_interface
from lidar_protocol.can_frames import block_addresses, command_addresses, host_message_addresses

INTERFACE = default_interface()
FOLDER = Path(lidar_protocol.__file__).parent
DOCUMENT = (FOLDER / "INTERFACE.md").read_text(encoding="utf-8")
DATABASE = cantools.database.load_file(FOLDER / "lidar.dbc", strict=True)


def test_the_document_states_what_the_emulator_does_on_a_line():
    assert "8 data bits, least significant first, no parity, 1 stop bit" in DOCUMENT
    assert f"{DEFAULT_BAUD} bit/s unless it is stated" in DOCUMENT
    assert (
        f"{DEFAULT_BITRATE // 1000} kbit/s, and {DEFAULT_DATA_BITRATE // 10**6} Mbit/s for the\ndata"
        in DOCUMENT
    )
    limiter, second_ns = RateLimiter(), 1_000_000_000
    at_once = limiter.take(10**6, 0)
    later = sum(limiter.take(10**6, second_ns // 100 * k) for k in range(1, 101))
    assert f"takes {at_once} bytes at once and {later} bytes a second" in DOCUMENT


def test_the_documents_are_up_to_date():
    hint = "run tests/protocol/make_documents.py"
    assert interface_document(INTERFACE, "descent.yaml", load("descent.yaml")) == DOCUMENT, hint
    assert lidar_icd.c_header(INTERFACE) == (FOLDER / "lidar.h").read_text(encoding="utf-8"), hint
    assert lidar_icd.dbc(INTERFACE) == (FOLDER / "lidar.dbc").read_text(encoding="utf-8"), hint


# The document alone.

STRUCT_CODES = {"u8": "B", "u16": "H", "i16": "h", "u32": "I", "i32": "i"}


def tables(text):
    """Every table of the document: its heading's cells, then its rows' cells."""
    found = re.findall(r"(?:^\|.*\|$\n?)+", text, re.MULTILINE)
    rows = [
        [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
        for table in found
    ]
    return [(table[0], table[2:]) for table in rows]


def field_of(row, data, first):
    """One field, by its row: bytes, bits, type, name, step, range and code."""
    where, bits, kind, _, step, limits, none, _ = row
    start, _, end = where.partition("-")
    block = data[first + int(start) : first + int(end or start) + 1]
    if kind == "cuc":
        return round(int.from_bytes(block, "big") * 10**9 / 2**24)
    if kind in STRUCT_CODES and bits == "7-0":
        (raw,) = struct.unpack(">" + STRUCT_CODES[kind], block)
    else:
        high, _, low = bits.partition("-")
        raw = block[0] >> int(low or high) & (1 << int(high) - int(low or high) + 1) - 1
    if none and raw == struct.unpack(">" + STRUCT_CODES[kind], bytes.fromhex(none.strip("`")[2:]))[0]:
        return None
    value = raw * float(step.split()[0]) if step else raw
    assert not limits or float(limits.split()[0]) <= value <= float(limits.split()[2].rstrip(","))
    return value


def test_a_decoder_built_from_the_document_reads_its_example():
    header_table, beam_table = (rows for heading, rows in tables(DOCUMENT)[2:4])
    blocks = [bytes.fromhex(block) for block in re.findall(r"```text\n([0-9a-f \n]+)```", DOCUMENT)]
    data = blocks[0]
    stated = {heading[0]: rows for heading, rows in tables(DOCUMENT)}
    for row in header_table:
        expected = next(float(value) for name, value in stated["header"] if name == row[3])
        assert field_of(row, data, 0) == pytest.approx(expected, abs=1)
    for row in beam_table:
        expected = next(values for name, *values in stated["beam"] if name == row[3])
        for k, text in enumerate(expected):
            value = field_of(row, data, 29 + 31 * k)
            assert value == (None if text == "none" else pytest.approx(float(text), abs=1e-9)), (row[3], k)


# CAN.


def dbc_decoded(frame):
    return DATABASE.get_message_by_frame_id(frame.can_id).decode(frame.data)


def test_the_dbc_marks_fd_frames_and_their_bit_rate_switch():
    formats = {message.frame_id: message.is_fd for message in DATABASE.messages}
    switched = {
        message.frame_id: attribute.value
        for message in DATABASE.messages
        if (attribute := message.dbc.attributes.get("CANFD_BRS")) is not None
    }
    assert DATABASE.dbc.attribute_definitions["CANFD_BRS"].default_value == "0"
    for can_set in ("core", "full", "fd"):
        for frame in all_slots(can_set):
            assert formats[frame.can_id] == frame.is_fd
            assert switched.get(frame.can_id, 0) == frame.bitrate_switch


def test_the_dbc_has_words_for_codes():
    sent = Device(INTERFACE).can_frames("full", example.HEADER, example.BEAMS)
    beams = [dbc_decoded(frame) for frame in sent if 0x108 <= frame.can_id < 0x110]
    quality = [dbc_decoded(frame) for frame in sent if 0x110 <= frame.can_id < 0x118]
    assert [beam["range_m"] for beam in beams[2:]] == ["none", "absent"]
    assert [str(beam["segments"]) for beam in beams[1:3]] == ["up_constant_down", "up_down"]
    assert [str(each["reason"]) for each in quality] == ["valid", "valid", "below_threshold", "not_fired"]
    assert [str(each["second_reason"]) for each in quality] == [
        *("below_threshold", "valid", "below_threshold", "not_fired")
    ]
    shot = {"shot_counter": 14, "mode": "track", "interface_version": 3, "shot": 30, "pattern": 0}
    assert dbc_decoded(sent[2]) == shot


def test_every_identifier_is_in_the_dbc_and_no_other():
    sent = {frame.can_id for s in ("core", "full", "fd") for frame in all_slots(s)}
    sent |= {*command_addresses(INTERFACE, 0), *host_message_addresses(INTERFACE, 0)} | {
        can_id for can_id, (unit, _) in block_addresses(INTERFACE).items() if unit == 0
    }
    assert sent == {message.frame_id for message in DATABASE.messages}


def all_slots(can_set):
    return Device(INTERFACE).can_frames(can_set, example.HEADER, [example.BEAMS[0]] * 8)
