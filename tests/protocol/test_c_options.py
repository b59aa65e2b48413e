"""Options of the generated C header: fewer beams, float instead of double, and no library beneath it."""

import re
import struct
import subprocess

import pytest
from c_programs import NEEDS_COMPILER, built, compiled, read
from conformance import SHOTS

from lidar_protocol import Device, Host, default_interface, load, shipped_interface
from lidar_protocol.definition_file import files

DEFAULT = (files("lidar_protocol") / "default.toml").read_text(encoding="utf-8")
FRAMINGS = ['kind = "cobs"', 'kind = "slip"', 'kind = "sync"\nsync = "EB90"\nlength = "u16"']
pytestmark = NEEDS_COMPILER

COUNTER = r"""
int main(void) {
    static lidar_receiver receiver;
    int byte;
    while ((byte = getchar()) != EOF) {
        lidar_feed(&receiver, (uint8_t)byte);
        while (lidar_next(&receiver)) {
            static lidar_measurement m;
            lidar_housekeeping health;
            unsigned unit;
            if (lidar_read_measurement(receiver.packet, receiver.packet_length, &unit, &m))
                printf("shot %u of %u beams, %.3f m\n", (unsigned)m.shot.shot, (unsigned)m.beam_count,
                       (double)m.beams[m.beam_count - 1u].range_m);
            if (lidar_read_housekeeping(receiver.packet, receiver.packet_length, &unit, &health))
                printf("health\n");
        }
    }
    printf("%u %u\n", (unsigned)sizeof(lidar_measurement),
           (unsigned)LIDAR_LONGEST_FRAME);
    return 0;
}
"""
SENDS = r"""
size_t command(uint8_t *to) { return lidar_encode_set_rate_hz(to, 0u, 1u, (lidar_real)20); }
"""
RECEIVES = r"""
bool received(lidar_receiver *receiver, uint8_t byte, lidar_measurement *shot) {
    unsigned unit;
    lidar_feed(receiver, byte);
    return lidar_next(receiver) && lidar_read_measurement(receiver->packet, receiver->packet_length, &unit, shot);
}
"""


def stream(interface):
    """Frames of 1 to 6 beams, and housekeeping, of a device."""
    device = Device(interface)
    header, beam = SHOTS[0]["header"], {**SHOTS[0]["beams"][0], "range_m": 2164.784}
    frames = [device.serial_bytes({**header, "shot": count}, [beam] * count) for count in range(1, 7)]
    return b"".join(frames) + device.housekeeping(0, dict.fromkeys(interface.housekeeping.names, 0))


@pytest.mark.parametrize("framing", FRAMINGS)
def test_a_host_with_memory_for_four_beams_refuses_more_and_reads_on(framing, tmp_path):
    interface = load(DEFAULT.replace('kind = "cobs"', framing, 1), "mine.toml")
    data = stream(interface)
    *lines, sizes = built(tmp_path, interface, COUNTER, "-DLIDAR_MAXIMUM_BEAMS=4")(data).splitlines()
    assert lines == [f"shot {count} of {count} beams, 2164.784 m" for count in range(1, 5)] + ["health"]
    measurement_bytes, longest_frame = sizes.split()
    assert int(measurement_bytes) < 1000
    assert int(longest_frame) == interface.link.framing.longest_frame(6 + 23 + 4 * 31 + 2)
    *lines, sizes = built(tmp_path, interface, COUNTER)(data).splitlines()
    assert lines == [f"shot {count} of {count} beams, 2164.784 m" for count in range(1, 7)] + ["health"]
    assert int(sizes.split()[-1]) == interface.link.framing.longest_frame(interface.maximum_packet_bytes)


@pytest.mark.parametrize("beams", ["0", "65", "-1"])
def test_a_number_of_beams_that_no_packet_has_is_refused(beams, tmp_path):
    done = compiled(tmp_path, default_interface(), "", "-c", f"-DLIDAR_MAXIMUM_BEAMS={beams}")
    assert done.returncode != 0
    assert "LIDAR_MAXIMUM_BEAMS must be 1 to 64" in done.stderr


def test_float_holds_the_nearest_single_precision_number(tmp_path):
    shots = read(tmp_path, default_interface(), stream(default_interface()), "-DLIDAR_USE_FLOAT")
    (single,) = struct.unpack("f", struct.pack("f", 2164.784))
    assert {shot["range_m_0"] for shot in shots if shot["kind"] == "measurement"} == {single}


def test_commands_of_a_host_with_floats(tmp_path):
    host = Host(default_interface(), 3)
    program = r"""
int main(void) {
    uint8_t to[LIDAR_LONGEST_COMMAND];
    const float rates_hz[] = {0.001f, 20.0f, 33.25f, 10000.0f, 0.0004f, 10001.0f, -1.0f, 0.0f / 0.0f};
    for (size_t k = 0u; k < sizeof rates_hz / sizeof rates_hz[0]; k++) {
        const size_t length = lidar_encode_set_rate_hz(to, 3u, k, rates_hz[k]);
        for (size_t j = 0u; j < length; j++)
            printf("%02x", to[j]);
        printf("\n");
    }
    return 0;
}
"""
    expected = [
        host.encode_command("set_rate_hz", sequence=k, rate_hz=rate_hz).hex()
        for k, rate_hz in enumerate([0.001, 20.0, 33.25, 10_000.0])
    ]
    run = built(tmp_path, default_interface(), program, "-DLIDAR_USE_FLOAT")
    assert run(b"").splitlines() == [*expected, "", "", "", ""]


@pytest.mark.parametrize("name", ["default", "altimeter"])
@pytest.mark.parametrize("option", ["-DLIDAR_USE_FLOAT", "-DANY"])
def test_it_stands_alone(name, option, tmp_path):
    """A freestanding compiler may call the four functions that it asks of every environment, and nothing else."""
    interface, program = default_interface(), SENDS + RECEIVES
    if name == "altimeter":  # it takes no commands
        interface, program = shipped_interface(name), RECEIVES
    done = compiled(tmp_path, interface, program, "-c", "-O2", "-ffreestanding", option)
    assert done.returncode == 0, done.stderr
    header = (tmp_path / "lidar.h").read_text()
    assert set(re.findall(r"#include <(\w+)\.h>", header)) == {"stdbool", "stddef", "stdint"}
    listed = subprocess.run(["nm", "-u", "main.o"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert set(listed.stdout.split()) - {"U"} <= {"memcpy", "memmove", "memset", "memcmp"}
