"""Commands encoded by the generated C header, compared byte by byte with the library and an example of INTERFACE.md."""

import pytest
from any_interface import document, trees, values
from c_programs import NEEDS_COMPILER, built
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from lidar_protocol import EncodeError, Host, default_interface, load
from lidar_protocol.definition_file import files
from lidar_protocol.fields import Constant, Counter, Number

DEFAULT = (files("lidar_protocol") / "default.toml").read_text(encoding="utf-8")
pytestmark = NEEDS_COMPILER

MAIN = """#include <float.h>
#include <math.h>
static void show(const uint8_t *data, size_t length) {
    for (size_t k = 0u; k < length; k++)
        printf("%02x", data[k]);
    printf("\\n");
}
int main(void) {
    uint8_t to[LIDAR_LONGEST_COMMAND];
"""


def reported(folder, interface, calls):
    """What these encoders write, a line each."""
    lines = "".join(f"    {call}\n" for call in calls)
    return built(folder, interface, MAIN + lines + "    return 0;\n}\n")(b"").split("\n")[:-1]


def framed(name, *arguments):
    return f"show(to, lidar_encode_{name}(to, {', '.join(map(literal, arguments))}));"


def literal(value):
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        return f"{value}ULL" if value >= 2**63 else "INT64_MIN" if value == -(2**63) else f"{value}LL"
    return value if isinstance(value, str) else repr(value)


@pytest.mark.parametrize(
    "framing", ['kind = "cobs"', 'kind = "slip"', 'kind = "sync"\nsync = "EB90"\nlength = "u16"']
)
def test_every_command_of_the_default_interface(framing, tmp_path):
    interface = load(DEFAULT.replace('kind = "cobs"', framing, 1), "mine.toml")
    host = Host(interface, 3)
    given_commands = [
        ("no_op", {}),
        ("set_mode", {"mode": 4}),
        ("set_pattern", {"pattern": 0}),
        ("set_rate_hz", {"rate_hz": 1.0}),
        ("set_rate_hz", {"rate_hz": 33.3335}),
        ("set_rate_hz", {"rate_hz": 10_000.0}),
        ("enable_beams", {"beams": 0xC0DB00FF}),
        ("time_at_tone", {"tone_ns": 4_000_000_000_999_999_999}),
        ("set_parameter", {"parameter": 0xDBC0, "number": -0.1}),
        ("reset", {"restart": 1}),
    ]
    expected = [
        host.encode_command(name, sequence=k + 190, **arguments).hex()
        for k, (name, arguments) in enumerate(given_commands)
    ]
    calls = [
        framed(name, 3, k + 190, *arguments.values()) for k, (name, arguments) in enumerate(given_commands)
    ]
    assert reported(tmp_path, interface, calls) == expected


def test_what_cannot_be_sent_has_no_bytes(tmp_path):
    calls = [
        framed("set_pattern", 0, 0, 256),
        framed("set_pattern", 0, 256, 1),
        framed("set_pattern", 16, 0, 1),
        framed("set_rate_hz", 0, 0, 0.0004),
        framed("set_rate_hz", 0, 0, 10_000.001),
        framed("set_rate_hz", 0, 0, -1.0),
        framed("set_rate_hz", 0, 0, "(double)NAN"),
        framed("set_rate_hz", 0, 0, "HUGE_VAL"),
        framed("time_at_tone", 0, 0, -1),
        framed("time_at_tone", 0, 0, 2**62),
        framed("set_parameter", 0, 0, 1, "(double)NAN"),
        framed("set_parameter", 0, 0, 1, 1e39),
        framed("no_op", 0, 0),
    ]
    *nothing, something = reported(tmp_path, default_interface(), calls)
    assert (nothing, something[:4]) == ([""] * 12, "0004")


def test_commands_on_can(tmp_path):
    interface = default_interface()
    host = Host(interface)
    given_commands = [
        ("set_pattern", {"pattern": 1}),
        ("set_rate_hz", {"rate_hz": 50.0}),
        ("time_at_tone", {"tone_ns": 1_500_490_785}),
        ("no_op", {}),
    ]
    frames = [host.encode_command_frame(name, sequence=9, **arguments) for name, arguments in given_commands]
    calls = [
        f'printf("%x ", LIDAR_CAN_ID_{name.upper()}); '
        f"show(to, lidar_pack_can_{name}(to, {', '.join(map(literal, [9, *arguments.values()]))})"
        f" ? LIDAR_CAN_COMMAND_{name.upper()}_BYTES : 0u);"
        for name, arguments in given_commands
    ]
    assert reported(tmp_path, interface, calls) == [
        f"{frame.can_id:x} {frame.data.hex()}" for frame in frames
    ]


@pytest.mark.slow
@given(trees(), st.data())
@seed(5)
@settings(
    max_examples=12,
    deadline=None,
    phases=[Phase.generate],
    database=None,
    suppress_health_check=list(HealthCheck),
)
def test_any_interface(tmp_path_factory, tree, data):
    interface = load(document(tree), "drawn.toml")
    entries = tree["commands"]["second"]["fields"]
    drawn = [data.draw(values(entries))[0] for _ in range(6)]
    host, expected, calls = Host(interface, interface.units - 1), [], []
    layout = interface.commands.by_name["second"].packet
    asked = [p.field for p in layout.placed[2:] if not isinstance(p.field.codec, Constant)]
    for k, arguments in enumerate(drawn):
        try:
            expected.append(host.encode_command("second", sequence=k, **arguments).hex())
        except EncodeError:
            expected.append("")
        words = [as_argument(field, arguments[field.key]) for field in asked]
        calls.append(framed("second", interface.units - 1, k, *words))
    assert reported(tmp_path_factory.mktemp("any"), interface, calls) == expected


def as_argument(field, value):
    """A value as C takes it: a counter as the caller's type holds it, and what is out of range where there is none."""
    codec = field.codec
    if isinstance(codec, Counter):
        return value % 2**64
    if value is not None:
        return value
    return codec.none + codec.offset if isinstance(codec, Number) and codec.whole else "(double)NAN"
