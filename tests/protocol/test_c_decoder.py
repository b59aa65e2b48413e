"""The generated C header, compiled as strictly as compilers go and run against bytes that the library did not make."""

import math

import pytest
from c_programs import NEEDS_COMPILER, built, read
from conformance import SHOTS, assert_golden

from lidar_protocol import Device, default_interface, load
from lidar_protocol.definition_file import files

DEFAULT = (files("lidar_protocol") / "default.toml").read_text(encoding="utf-8")
pytestmark = NEEDS_COMPILER


@pytest.mark.parametrize(
    "framing",
    [
        'kind = "cobs"',
        'kind = "slip"',
        'kind = "sync"\nsync = "EB90"\nlength = "u16"',
        'kind = "sync"\nsync = "5555"\nlength = "u16"',
    ],
)
def test_golden_shots_answers_and_health_between_garbage(framing, tmp_path):
    interface = load(DEFAULT.replace('kind = "cobs"', framing, 1), "mine.toml")
    device = Device(interface, 15)
    if "cobs" in framing:
        frames = [bytes.fromhex(shot["frame"]) for shot in SHOTS]
    else:
        frames = [interface.link.framing.encode(bytes.fromhex(shot["packet"])) for shot in SHOTS]
    answer = device.acknowledge(0, "no_op", time_ns=0, sequence=3, verdict="out_of_range")
    ending = interface.link.framing.encode(b"garbage")
    health = device.housekeeping(
        0,
        {
            **dict.fromkeys(interface.housekeeping.names, 0),
            "temperature_c": -12.34,
            "laser_power_w": None,
            "interlock_closed": True,
        },
    )
    damaged = bytearray(frames[0])
    damaged[20] ^= 1
    noise = b"\x55"
    stream = b"\x55" * 3000 + ending + noise + noise.join(frames) + bytes(damaged) + answer + ending + health
    *shots, verdict, state = read(tmp_path, interface, stream + bytes(3000))
    assert_golden(shots)
    assert (verdict["kind"], verdict["unit"], verdict["sequence"], verdict["verdict"]) == (
        "acknowledge",
        15,
        3,
        5,
    )
    assert (state["kind"], state["unit"], state["laser_power_w"]) == ("housekeeping", 15, None)
    assert math.isclose(state["temperature_c"], -12.34)


def test_can_messages_in_c(tmp_path):
    interface = default_interface()
    data = ", ".join(f"0x{byte:02x}" for byte in bytes.fromhex("efe22108 30f8f38c"))
    program = f"""
int main(void) {{
    static const uint8_t data[LIDAR_CAN_BEAM_BYTES] = {{{data}}};
    lidar_can_beam beam;
    lidar_unpack_can_beam(data, &beam);
    printf("0x%X %d %.3f %.4f %llu %.0f\\n", LIDAR_CAN_ID_BEAM, beam.range_valid, beam.range_m, beam.closing_speed_mps,
           (unsigned long long)beam.segments, beam.snr_db);
    return 0;
}}"""
    assert built(tmp_path, interface, program)(b"") == "0x108 1 2164.784 -46.1940 7 34\n"


UNSTUFFER = r"""
int main(void) {
    const uint8_t values[] = {0u, 1u, 2u, 3u, 4u, 255u};
    for (unsigned number = 0u; number < 6u * 6u * 6u * 6u; number++) {
        uint8_t frame[4];
        unsigned rest = number;
        for (size_t k = 0u; k < 4u; k++, rest /= 6u)
            frame[k] = values[rest % 6u];
        for (size_t k = 0u; k < 4u; k++)
            printf("%02x", frame[k]);
        const size_t length = lidar_unstuff(frame, 4u);
        printf(" ");
        for (size_t k = 0u; k < length; k++)
            printf("%02x", frame[k]);
        printf("\n");
    }
    return 0;
}
"""


def test_frames_that_nothing_encodes_are_empty_under_sanitizers(tmp_path):
    """Among them a zero byte inside, of which the receiver passes none on but a caller of its own may."""
    program = built(tmp_path, default_interface(), UNSTUFFER)
    for line in program(b"").splitlines():
        stuffed, _, content = line.partition(" ")
        assert bytes.fromhex(content) == unstuffed(bytes.fromhex(stuffed)), stuffed


def unstuffed(frame):
    """Content of a frame by the definition of COBS (Cheshire and Baker, 1999); empty if it is none."""
    content = b""
    while frame:
        code, run, frame = frame[0], frame[1 : frame[0]], frame[frame[0] :]
        if code == 0 or len(run) != code - 1:
            return b""
        content += run + (b"\0" if code < 255 and frame else b"")
    return content
