"""Messages of the host, such as its navigation solution: by hand, in any interface, damaged, on CAN, and in C."""

import binascii
import struct
from itertools import pairwise

import cantools
import pytest
from any_interface import block, document, fields, same, trees, values
from c_programs import NEEDS_COMPILER
from hypothesis import HealthCheck, Phase, example, given, seed, settings
from hypothesis import strategies as st
from test_any_interface import RELAXED
from test_c_commands import literal, reported
from test_interface_definition import DEFAULT as TEXT
from test_interface_definition import refusal

import lidar_icd
from lidar_protocol import (
    BadCommand,
    CanCommandReader,
    CommandReader,
    EncodeError,
    Host,
    HostMessage,
    cobs,
    default_interface,
    load,
    packet,
)
from lidar_protocol.fields import Constant, Counter

DEFAULT = default_interface()
AXES = ("east", "north", "up")
SOLUTION = {
    "time_ns": 1_500_000_000,
    "mode": "aided",
    "altitude_m": 812.345,
    **dict(zip([f"position_{axis}_m" for axis in AXES], (-12.5, 3.25, 912.0), strict=True)),
    **dict(zip([f"velocity_{axis}_mps" for axis in AXES], (1.5, -0.25, -62.1234), strict=True)),
    "sigma_altitude_m": 1.5,
    **dict(zip([f"sigma_position_{axis}_m" for axis in AXES], (10.0, 11.0, None), strict=True)),
    **dict(zip([f"sigma_velocity_{axis}_mps" for axis in AXES], (0.002, 0.003, 0.001), strict=True)),
    **{f"{what}_trust_{beam}": "used" for beam in range(4) for what in ("range", "speed")},
    **{f"{what}_trust_{beam}": "not_judged" for beam in range(4, 8) for what in ("range", "speed")},
    "speed_trust_2": "gated",
}
WORDS = {"aided": 3, "used": 1, "not_judged": 0, "gated": 3}
NUMBERS = {key: WORDS.get(value, value) for key, value in SOLUTION.items()}


def body_by_hand(sequence):
    """The message as INTERFACE.md states it, with `struct` alone."""
    text = struct.pack(">BBIB2xB", 16, sequence, 1, 0x80, 3)
    text += struct.pack(">i3i3i", 812_345, -12_500, 3250, 912_000, 15_000, -2500, -621_234)
    for sigma in (1500, 10_000, 11_000, 0xFFFFFF, 200, 300, 100):
        text += sigma.to_bytes(3, "big")
    return text + bytes((0x11, 0x11, 0x13, 0x11, 0, 0, 0, 0))


def framed(body, unit=1, sequence=9):
    head = struct.pack(">HHH", 0x1000 | 0x2A0 + unit, 0xC000 | sequence, len(body) + 1)
    plain = head + body
    return b"\0" + cobs.encode(plain + struct.pack(">H", binascii.crc_hqx(plain, 0xFFFF))) + b"\0"


def test_a_solution_by_hand():
    sent = framed(body_by_hand(9))
    assert Host(DEFAULT, 1).encode_message("navigation", sequence=9, **SOLUTION) == sent
    assert CommandReader(DEFAULT, 1).feed(sent) == [HostMessage(1, "navigation", 9, NUMBERS)]
    assert CommandReader(DEFAULT, 2).feed(sent) == []


@given(trees(), st.data())
@RELAXED
def test_any_message_of_any_interface(tree, data):
    entries = data.draw(fields("m"))
    tree["host_messages"] = {"solution": {"code": 40, "fields": entries}}
    interface = load(document(tree), "drawn.toml")
    unit, order = interface.units - 1, tree["interface"]["byte_order"]
    given_values, bits = data.draw(values(entries))
    sent = Host(interface, unit).encode_message("solution", sequence=200, **given_values)
    head = [{"name": "command", "type": "u8"}, {"name": "sequence", "type": "u8"}]
    expected = block([*head, *entries], bits | {"command": 40, "sequence": 200}, order)
    _, body = packet.unseal(interface.link, interface.link.framing.packet_of(sent))
    assert body == expected
    (message,) = CommandReader(interface, unit).feed(sent)
    assert (type(message), message.name, message.sequence) == (HostMessage, "solution", 200)
    for entry in entries:
        if "name" in entry:
            assert same(message.values[entry["name"]], given_values[entry["name"]], entry), entry


@pytest.mark.parametrize(
    ("place", "value", "verdict"),
    [
        (slice(9, 10), b"\x09", "out_of_range"),  # a mode without a word
        (slice(62, 63), b"\x17", "out_of_range"),  # a trust without a word
        (slice(66, None), b"", "malformed"),  # too short
        (slice(67, None), b"\0", "malformed"),  # too long
        (slice(1, None), b"", "malformed"),  # without its number
    ],
)
def test_a_bad_message_is_told_from_a_good_one(place, value, verdict):
    body = bytearray(body_by_hand(9))
    body[place] = value
    reader = CommandReader(DEFAULT, 1)
    bad, good = reader.feed(framed(bytes(body)) + framed(body_by_hand(10)))
    assert (type(bad), bad.code, bad.verdict) == (BadCommand, 16, verdict)
    assert (good, reader.counters.rejected) == (HostMessage(1, "navigation", 10, NUMBERS), 1)


@pytest.mark.parametrize("number", [float("nan"), float("inf"), -2e6])
def test_a_floating_point_field_has_to_be_a_number_in_its_range(number):
    text = TEXT.replace(
        'name = "altitude_m", type = "i32", scale = 0.001, unit = "m", none = -2147483648',
        'name = "altitude_m", type = "f32", range = [-1e6, 1e6]',
        1,
    ).partition("[[can.host_messages]]")[0]
    interface = load(text, "mine.toml")
    body = bytearray(body_by_hand(9))
    body[10:14] = struct.pack(">f", number)
    (bad,) = CommandReader(interface, 1).feed(framed(bytes(body)))
    assert (bad.verdict, bad.text) == ("out_of_range", "navigation: altitude_m is out of range")
    with pytest.raises(EncodeError, match="altitude_m is out of range"):
        Host(interface).encode_message("navigation", sequence=9, **SOLUTION | {"altitude_m": number})
    with pytest.raises(EncodeError, match="no navigation on CAN"):
        Host(interface).encode_message_frames("navigation", sequence=9, **SOLUTION)


@pytest.mark.parametrize(
    ("changed", "complaint"),
    [
        ({"altitude_m": 1e9}, "altitude_m is out of range of 1000000000.0"),
        ({"sigma_velocity_up_mps": -1.0}, "sigma_velocity_up_mps is out of range"),
        ({"time_ns": None}, "time_ns"),
        ({"mode": "asleep"}, "'asleep' is none of off, alignment"),
        ({"range_trust_7": 7}, "range_trust_7 has no such value of 7"),
        ({"range_trust_8": 0}, "navigation has no range_trust_8"),
        ({"sequence": 256}, "sequence"),
    ],
)
def test_a_host_refuses_what_a_device_would(changed, complaint):
    for encode in (Host(DEFAULT).encode_message, Host(DEFAULT).encode_message_frames):
        with pytest.raises(EncodeError, match=complaint):
            encode("navigation", **{"sequence": 1, **SOLUTION, **changed})
    with pytest.raises(EncodeError, match="message navigatoin: the interface has navigation"):
        Host(DEFAULT).encode_message("navigatoin", sequence=1)
    missing = {key: value for key, value in SOLUTION.items() if key != "altitude_m"}
    with pytest.raises(EncodeError, match="altitude_m is missing"):
        Host(DEFAULT).encode_message("navigation", sequence=1, **missing)


def frames(sequence):
    return Host(DEFAULT, 2).encode_message_frames("navigation", sequence=sequence, **SOLUTION)


def read_frames(reader, sent):
    return [message for frame in sent for message in reader.feed(frame.can_id, frame.data)]


def test_the_frames_of_a_solution_in_a_can_database():
    database = cantools.database.load_string(lidar_icd.dbc(DEFAULT), "dbc", strict=True)
    found = {}
    for frame in frames(7):
        message = database.get_message_by_frame_id(frame.can_id - 2 * DEFAULT.can.unit_stride)
        assert (message.senders, len(frame.data), frame.is_fd) == (["HOST"], 8, False)
        found |= message.decode(frame.data)
        assert message.encode(message.decode(frame.data)) == frame.data
    assert found.pop("time_seconds") + found.pop("time_fraction") == 1.5
    assert found.pop("sequence") == 7
    expected = {
        key: "none" if value is None else value for key, value in SOLUTION.items() if key != "time_ns"
    }
    assert found == {key: v if isinstance(v, str) else pytest.approx(v) for key, v in expected.items()}


def test_frames_out_of_order_cost_their_own_message():
    first, second, third = frames(1), frames(2), frames(255)
    reader = CanCommandReader(DEFAULT, 2)
    expected = [HostMessage(2, "navigation", number, NUMBERS) for number in (1, 255)]
    assert read_frames(reader, first) == expected[:1]
    assert reader.counters.incomplete == 0
    # Eight frames of the second are dropped: three before the gap, five after it.
    assert read_frames(reader, [*second[:3], *second[4:]]) == []
    assert reader.counters.incomplete == 8
    # The second's end does not complete the third's start, nor does a frame that is cut.
    assert read_frames(reader, [*third[:5], *second[5:]]) == []
    assert read_frames(reader, [*third[:8], third[8]._replace(data=third[8].data[:7])]) == []
    assert reader.counters.incomplete == 8 + 9 + 9
    assert read_frames(reader, [*third[:2], *third]) == expected[1:]
    assert (reader.counters.incomplete, reader.counters.messages) == (28, 2)
    bad = third[8]._replace(data=b"\xff\x09" + third[8].data[2:])
    (rejected,) = read_frames(reader, [*third[:8], bad])
    assert (rejected.verdict, rejected.sequence) == ("out_of_range", 255)


@given(
    st.lists(st.tuples(st.integers(0, 8), st.booleans(), st.binary(max_size=9))),
    st.lists(st.binary(max_size=100)),
)
@example([(0, True, b"")] * 9, [body_by_hand(9)])
@settings(deadline=None)
def test_nothing_that_arrives_raises_or_costs_the_next_message(parts, portions):
    own, can, line = frames(3), CanCommandReader(DEFAULT, 2), CommandReader(DEFAULT, 2)
    for place, is_whole, data in parts:
        can.feed(own[place].can_id, own[place].data if is_whole else data)
    for portion in portions:
        line.feed(portion)
        line.feed(framed(portion, unit=2))
    expected = HostMessage(2, "navigation", 3, NUMBERS)
    assert read_frames(can, own)[-1] == expected
    assert line.feed(b"\0" + Host(DEFAULT, 2).encode_message("navigation", sequence=3, **SOLUTION)) == [
        expected
    ]


@given(st.lists(st.integers(0, 5000), max_size=6))
def test_a_stream_cut_anywhere(cuts):
    host = Host(DEFAULT)
    sent = [host.encode_message("navigation", sequence=n, **SOLUTION) for n in range(3)]
    stream = sent[0] + host.encode_command("no_op", sequence=9) + sent[1][:40] + sent[2]
    reader = CommandReader(DEFAULT)
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    found = [each for start, end in pairwise(edges) for each in reader.feed(stream[start:end])]
    assert [(each.name, each.sequence) for each in found] == [
        ("navigation", 0),
        ("no_op", 9),
        ("navigation", 2),
    ]
    assert reader.counters.bad_length + reader.counters.bad_crc + reader.counters.bad_stuffing == 1


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("code = 16", "code = 7", ["host_messages.navigation.code", "7", "unique"]),
        ("[host_messages.navigation]", "[host_messages.reset]", ["host_messages.reset", "no command has"]),
        ('message = "navigation"', 'message = "position"', ["message", "navigation", "position"]),
        (
            'fields = [{ name = "altitude_m" }, ',
            "fields = [",
            ["can.host_messages: navigation", "altitude_m", "each field of navigation in one of them"],
        ),
        ("id = 0x3F", "id = 0x3E", ["navigation_use.id", "no other message"]),
        ("[host_messages.navigation]", "[[unused]]", ["can.host_messages: must be left out without"]),
        ("id = 0x3F", "id = 0x40", ["navigation_use.id", "below unit_stride"]),
    ],
)
def test_definitions_that_are_refused(old, new, named):
    text = refusal(old, new)
    assert all(word in text for word in named), text


def in_c(layout, name, given_values, unit=0):
    """The call that encodes a message in C."""
    lines = [f"lidar_message_{name} m = {{0}};"]
    for placed in layout.placed:
        field, value = placed.field, given_values.get(placed.field.key)
        if value is None or isinstance(field.codec, Constant):
            continue
        value = value % 2**64 if isinstance(field.codec, Counter) else value
        lines.append(f"m.{field.key} = {literal(value)};")
        if f"has_{field.key};" in given_values["header"]:
            lines.append(f"m.has_{field.key} = true;")
    return " ".join(["{", *lines, f"show(to, lidar_encode_{name}(to, {unit}, &m));", "}"])


@NEEDS_COMPILER
def test_the_c_header_encodes_a_solution(tmp_path):
    header, layout = lidar_icd.c_header(DEFAULT), DEFAULT.commands.messages_by_name["navigation"].packet
    given_values = NUMBERS | {"sequence": 9, "header": header}
    parts = DEFAULT.commands.messages_by_name["navigation"].can_parts
    calls = [
        "uint8_t message[LIDAR_LONGEST_MESSAGE];",
        in_c(layout, "navigation", given_values, 2).replace("(to,", "(message,"),
        in_c(layout, "navigation", given_values | {"altitude_m": 3e6}).replace("(to,", "(message,"),
        in_c(layout, "navigation", given_values | {"altitude_m": "(double)NAN"}).replace("(to,", "(message,"),
    ]
    for part in parts:
        call = f"show(to, lidar_pack_can_{part.name}(to, &m) ? LIDAR_CAN_{part.name.upper()}_BYTES : 0u);"
        both = f'printf("%x ", LIDAR_CAN_ID_{part.name.upper()}); {call}'
        calls.append(in_c(layout, "navigation", given_values).partition("show(")[0] + both + " }")
    sent = Host(DEFAULT, 2).encode_message("navigation", sequence=9, **SOLUTION).hex()
    on_can = Host(DEFAULT).encode_message_frames("navigation", sequence=9, **SOLUTION)
    expected = [sent, "", "", *(f"{frame.can_id:x} {frame.data.hex()}" for frame in on_can)]
    assert reported(tmp_path, DEFAULT, calls) == expected


@pytest.mark.slow
@NEEDS_COMPILER
@given(trees(), st.data())
@seed(7)
@settings(
    max_examples=8,
    deadline=None,
    phases=[Phase.generate],
    database=None,
    suppress_health_check=list(HealthCheck),
)
def test_the_c_header_encodes_any_message(tmp_path_factory, tree, data):
    entries = data.draw(fields("m"))
    tree["host_messages"] = {"solution": {"code": 40, "fields": entries}}
    interface = load(document(tree), "drawn.toml")
    header, host = lidar_icd.c_header(interface), Host(interface, interface.units - 1)
    layout = interface.commands.messages_by_name["solution"].packet
    expected, calls = [], ["uint8_t message[LIDAR_LONGEST_MESSAGE]; (void)to;"]
    for k in range(6):
        drawn = data.draw(values(entries))[0] | {"sequence": k}
        expected.append(host.encode_message("solution", **drawn).hex())
        call = in_c(layout, "solution", drawn | {"header": header}, interface.units - 1)
        calls.append(call.replace("(to,", "(message,"))
    assert reported(tmp_path_factory.mktemp("any"), interface, calls) == expected
