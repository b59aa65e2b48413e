"""Interface definitions: what is refused, and how it is reported."""

import tomllib
from contextlib import suppress
from copy import deepcopy
from datetime import date
from decimal import Decimal
from importlib.resources import files
from unittest.mock import patch

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lidar_icd import interface_markdown
from lidar_protocol import DefinitionError, default_interface
from lidar_protocol.definition_file import load

DEFAULT = (files("lidar_protocol") / "default.toml").read_text(encoding="utf-8")


def refusal(old, new):
    """The complaint about the default definition with its first `old` replaced."""
    assert old in DEFAULT
    with pytest.raises(DefinitionError) as caught:
        load(DEFAULT.replace(old, new, 1), "mine.toml")
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith("mine.toml: ")
    return text


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("version = 3", "version = 256", ["packet.header: interface_version", "8 bits", "holds 256"]),
        ("version = 3", "version = true", ["interface.version", "True"]),
        ("version = 3", "version = 65536", ["interface.version", "65536", "0 to 65535"]),
        ("units = 16", "", ["interface.units: must be a whole number", "(missing)"]),
        ('byte_order = "big"', 'byte_order = "middle"', ["interface.byte_order", "middle", "big"]),
        ('byte_order = "big"', "byte_order = {}", ["interface.byte_order", "big or little"]),
        ('kind = "cobs"', 'kind = "sync"\nsync = "EB90"\nlength = {}', ["length", "u8 or"]),
        ("measurement = 0x2A0", "measurement = 0x7F8", ["header.apid.measurement", "2040", "2031"]),
        ("measurement = 0x2A0", "measurement = -1", ["header.apid.measurement", "-1", "0 to 2031"]),
        ("measurement = 0x2A0", "measurement = 0x2A0\ncolour = 1", ["header.apid", "colour"]),
        ('type = "u8"', 'type = "u65"', ["packet.header[2].type", "u65", "u1 to u64"]),
        ('values = "mode"', 'values = "moods"', ["packet.header[3].values", "moods", "reason"]),
        ("scale = 0.01", "scael = 0.01", ["packet.beam[8].scael: no such key; did you mean scale? "]),
        ("units = 16", "unit = 16", ["interface.units: must be a whole number", "or rename unit (missing)"]),
        ('type = "u8"', "", ["packet.header[2].type: must be bool, cuc, f32", "(missing)"]),
        ("scale = 0.01", "scale = 0", ["packet.beam[8].scale", "above 0"]),
        ("scale = 0.01", "scale = nan", ["packet.beam[8].scale", "finite"]),
        ("none = -32768", "none = -32769", ["packet.beam[8]", "-32769"]),
        ("none = -32768", "none = 12", ["packet.beam[8]", "12", "outside the range"]),
        ('outside = "nearest"', 'outside = "wrap"', ["packet.beam[7].outside", "wrap", "none or nearest"]),
        ('name = "due_ns"', 'name = "time_ns"', ["packet.header[1].name", "time_ns"]),
        ('name = "due_ns"', 'name = "class"', ["packet.header[1].name", "class", "keyword of C"]),
        ('name = "returns"', 'name = "has_range_m"', ["packet.beam[9].name", "range_m", "has_"]),
        ("range = [0, 90]", "range = [90, 0]", ["packet.beam[15].range", "ascending"]),
        (
            'kind = "cobs"',
            'kind = "sync"\nsync = "EB90"\nlength = "u8"',
            ["mine.toml: framing.length", "255"],
        ),
        (
            'type = "u32", meaning = "Bit k',
            'type = "u64", meaning = "Bit k',
            ["mine.toml: can.commands: enable_beams"],
        ),
        ("[commands.no_op]", '[commands."*/"]', ["mine.toml: commands: must be tables named", "'*/'"]),
        ("id_base = 0x100", "id_base = 0x800", ["can.id_base", "2048", "0 to 2047"]),
        ("id_base = 0x100", "id_base = 0x500", ["can.id_base", "11 bits"]),
        ("id = 0x10", "id = 0x0A", ["quality.id", "10", "no other message has"]),
        ("unit_stride = 0x40", "unit_stride = 0x20", ["fd_header.id", "unit_stride"]),
        ('sets = ["full"]', 'sets = ["some"]', ["can.messages[1].sets", "some"]),
        ('all_of = "beam"', 'all_of = "beams"', ["can.messages[7].fields[2].all_of", "beams"]),
        (
            '{ name = "shot_counter" },\n    { name = "details" },',
            '{ name = "details" },',
            ["can.messages[0].fields", "shot_counter"],
        ),
        (
            '{ name = "due_ns" },',
            '{ name = "due_ns" }, { spare = 1 },',
            ["can.messages[1].fields", "65 bits", "64"],
        ),
        (
            '{ name = "due_ns" },',
            '{ name = "do_ns" },',
            ["can.messages[1].fields[4].name", "do_ns", "beside a type"],
        ),
        ('parity = "none"', 'parity = "mark"', ["uart.parity", "mark", "none or even or odd"]),
        ("stop_bits = 1", "stop_bits = 1.5", ["uart.stop_bits", "1.5", "1 to 2"]),
        ("stop_bits = 1", "data_bits = 7", ["uart.data_bits: no such key"]),
        ("[interface]", "[interface", ["TOML"]),
    ],
)
def test_what_cannot_be_used_is_named(old, new, named):
    text = refusal(old, new)
    for part in named:
        assert part in text


def test_beams_are_counted_up_to_what_fits():
    interface = default_interface()
    layouts = [(interface.packet.header, interface.packet.maximum_beams)]
    layouts += [(each.layout, interface.can.beam_slots) for each in interface.can.messages if each.opens_set]
    for layout, most in layouts:
        (codec,) = (placed.field.codec for placed in layout.placed if placed.field.name == "beam_count")
        assert codec.limits == (1, most)


TREES = {
    name: tomllib.loads((files("lidar_protocol") / f"{name}.toml").read_text(), parse_float=Decimal)
    for name in ("default", "altimeter")
}
NUMBERS = [0, -1, 2**70, *map(Decimal, ("1.5", "-0", "5e-324", "1e308", "1e999999999", "inf", "nan"))]
ODD = [*NUMBERS, True, "", "\0", "x", [], {}, [{}], [[]], ["a"], [1, 0], {"a": []}, date(2026, 1, 1)]


def places(tree, at=()):
    """The keys that lead to each value of a definition."""
    entries = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in entries:
        yield (*at, key)
        yield from places(value, (*at, key))


PLACES = [(name, place) for name, tree in TREES.items() for place in places(tree)]


@settings(max_examples=400)
@given(at=st.sampled_from(PLACES), value=st.sampled_from(ODD))
@example(at=("default", ("can", "messages", 0, "fields", 0, "name")), value=[])
@example(at=("default", ("packet", "beam", 8, "scale")), value=Decimal("1e999999999"))
@example(at=("default", ("packet", "beam", 8, "range")), value=[Decimal("-1e999999999"), 1])
def test_a_strange_value_is_refused_or_usable(at, value):
    name, (*outer, key) = at
    tree = within = deepcopy(TREES[name])
    for each in outer:
        within = within[each]
    within[key] = value
    with patch("tomllib.loads", return_value=tree), suppress(DefinitionError):
        load("", "strange.toml").maximum_packet_bytes  # noqa: B018


def test_the_serial_format_is_the_definitions_own_and_stands_in_its_document():
    assert default_interface().serial_format == "8N1"
    bare = DEFAULT.replace('[uart]\nparity = "none"\nstop_bits = 1\n', "")
    assert load(bare, "bare.toml").serial_format == "8N1"
    own = DEFAULT.replace('parity = "none"\nstop_bits = 1', 'parity = "odd"\nstop_bits = 2')
    interface = load(own, "own.toml")
    assert interface.serial_format == "8O2"
    assert "odd parity, 2 stop bits" in interface_markdown(interface)


def test_units_without_a_field_are_refused_by_the_file():
    text = (files("lidar_protocol") / "altimeter.toml").read_text(encoding="utf-8")
    assert '{ name = "unit", type = "u2" }' in text
    with pytest.raises(DefinitionError, match=r"^mine\.toml: header\.fields: unit: .* 4 units .*missing"):
        load(text.replace('{ name = "unit", type = "u2" }', "{ spare = 2 }"), "mine.toml")
