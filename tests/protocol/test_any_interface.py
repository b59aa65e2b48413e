"""Any interface encodes by its definition, and decodes to what was sent."""

import binascii
import struct
from itertools import pairwise

import pytest
from any_interface import block, document, fields, same, trees, values
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lidar_protocol import (
    Acknowledge,
    Command,
    CommandReader,
    Device,
    Host,
    Housekeeping,
    SerialReceiver,
    load,
)
from lidar_protocol.crc import CRCS
from lidar_protocol.layout import Layout

RELAXED = settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow], deadline=None)


def drawn(tree):
    return load(document(tree), "drawn.toml")


@given(st.sampled_from(["big", "little"]), st.data())
@RELAXED
def test_a_block_is_its_fields_bit_by_bit(order, data):
    entries = data.draw(fields("x", most=9))
    tree = {
        "interface": {"name": "block", "version": 1, "units": 1, "byte_order": order, "epoch": "then"},
        "framing": {"kind": "slip"},
        "crc": {"kind": "none"},
        "header": {"kind": "plain", "fields": [{"name": "unit", "type": "u8"}]},
        "packet": {"header": entries},
    }
    layout: Layout = drawn(tree).packet.header
    given_values, bits = data.draw(values(entries))
    packed = layout.pack(given_values)
    assert packed == block(entries, bits, order)
    back = layout.unpack(b"\xff" + packed, 1)
    for entry in entries:
        if "name" in entry:
            assert same(back[entry["name"]], given_values[entry["name"]], entry), entry


@given(trees(), st.data())
@RELAXED
def test_the_other_way_and_the_answers_come_back(tree, data):
    interface = drawn(tree)
    unit = interface.units - 1
    device, receiver = Device(interface, unit), SerialReceiver(interface)
    (answer,) = receiver.receive(device.acknowledge(3, "second", sequence=200, verdict="bad_sequence"))
    assert (type(answer), answer.sequence, answer.verdict) == (Acknowledge, 200, "bad_sequence")
    reported, _ = data.draw(values(tree["housekeeping"]))
    (health,) = receiver.receive(device.housekeeping(70_000, reported))
    assert isinstance(health, Housekeeping)
    for entry in tree["housekeeping"]:
        if "name" in entry:
            assert same(health.values[entry["name"]], reported[entry["name"]], entry), entry
    entries = tree["commands"]["second"]["fields"]
    arguments, _ = data.draw(values(entries))
    if any(value is None for value in arguments.values()):
        arguments = {}
    name = "second" if arguments else "first"
    reader = CommandReader(interface, unit)
    (command,) = reader.feed(Host(interface, unit).encode_command(name, sequence=255, **arguments))
    assert (type(command), command.name, command.sequence) == (Command, name, 255)
    for entry in entries if arguments else ():
        if "name" in entry:
            assert same(command.values[entry["name"]], arguments[entry["name"]], entry), entry


@given(trees(), st.data(), st.binary(max_size=80), st.binary(max_size=80))
@RELAXED
def test_garbage_costs_no_command(tree, data, before, after):
    """With a check, nothing but what was sent comes out, however the stream is cut."""
    tree["crc"] |= {"kind": "crc32", "over": "packet"}
    interface = drawn(tree)
    host = Host(interface)
    sent = [host.encode_command("first", sequence=n) for n in (1, 2, 3)]
    quiet = bytes(2000)  # what a sync word by chance, and its length, may still wait for
    stream = before + sent[0] + sent[1] + after + sent[2] + quiet
    reader = CommandReader(interface)
    edges = [0, *sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=5))), len(stream)]
    found = [command for start, end in pairwise(edges) for command in reader.feed(stream[start:end])]
    assert [command.sequence for command in found] == [1, 2, 3]
    counters = reader.counters
    assert counters.messages == 3
    assert reader.buffered_bytes <= interface.link.framing.longest_frame(interface.maximum_command_bytes)


@given(trees(), st.lists(st.binary(max_size=100)))
@RELAXED
def test_nothing_that_arrives_raises(tree, portions):
    interface = drawn(tree)
    receiver, reader = SerialReceiver(interface), CommandReader(interface)
    for portion in portions:
        receiver.receive(portion)
        reader.feed(portion)
        for _ in range(2):  # bytes that look right
            receiver.receive(interface.link.framing.encode(portion) if portion else b"")
            reader.feed(interface.link.framing.encode(portion) if portion else b"")
    longest = interface.link.framing.longest_frame(interface.maximum_packet_bytes)
    assert receiver.buffered_bytes <= longest


@pytest.mark.parametrize("name", sorted(CRCS))
def test_check_values_of_the_catalogue(name):
    crc = CRCS[name]
    assert crc.function(b"123456789") == crc.by_table(b"123456789") == crc.check


@given(st.sampled_from(sorted(CRCS)), st.binary(max_size=300))
def test_the_fast_way_and_the_table_agree(name, data):
    assert CRCS[name].function(data) == CRCS[name].by_table(data)


@given(st.binary(max_size=300))
def test_crcs_against_the_standard_library(data):
    assert CRCS["crc32"].by_table(data) == binascii.crc32(data)
    assert CRCS["crc16_ccitt_false"].by_table(data) == binascii.crc_hqx(data, 0xFFFF)
    assert CRCS["crc16_xmodem"].by_table(data) == binascii.crc_hqx(data, 0)


def test_a_modbus_frame_of_the_specification():
    """Read holding registers, address 17, of the MODBUS examples: 11 03 00 6B 00 03, CRC 76 87 (low byte first)."""
    assert struct.pack("<H", CRCS["crc16_modbus"].function(bytes.fromhex("1103006B0003"))) == bytes.fromhex(
        "7687"
    )
