"""Options of the generated C header: fewer beams, float instead of double, and no library beneath it."""

import json
import re
import shutil
import struct
import subprocess
from pathlib import Path

import pytest

import lidar_icd
from lidar_protocol import Device, Host, default_interface, load, shipped_interface
from lidar_protocol.definition_file import files

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
FLAGS = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-Wconversion", "-Wdouble-promotion"]
SANITIZERS = "-fsanitize=undefined,address"
SHOTS = json.loads((Path(__file__).parent / "golden.json").read_text(encoding="utf-8"))
DEFAULT = (files("lidar_protocol") / "default.toml").read_text(encoding="utf-8")
FRAMINGS = ['kind = "cobs"', 'kind = "slip"', 'kind = "sync"\nsync = "EB90"\nlength = "u16"']
pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler on this machine")

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


def compile_c(folder, program, *flags, interface=None):
    """Compile a program on the header of an interface, by default the shipped one."""
    (folder / "lidar.h").write_text(lidar_icd.c_header(interface or default_interface()))
    (folder / "main.c").write_text('#include "lidar.h"\n' + program)
    command = [COMPILER, *FLAGS, *flags, "main.c"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def output(folder, program, data, *flags, interface=None):
    """What the program prints when it reads these bytes."""
    with_stdio = "#include <stdio.h>\n" + program
    built = compile_c(folder, with_stdio, "-o", "main", SANITIZERS, *flags, interface=interface)
    assert built.returncode == 0, built.stderr
    ran = subprocess.run([folder / "main"], input=data, capture_output=True, check=True)
    return ran.stdout.decode().splitlines()


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
    *lines, sizes = output(tmp_path, COUNTER, data, "-DLIDAR_MAXIMUM_BEAMS=4", interface=interface)
    assert lines == [f"shot {count} of {count} beams, 2164.784 m" for count in range(1, 5)] + ["health"]
    measurement_bytes, longest_frame = sizes.split()
    assert int(measurement_bytes) < 1000
    assert int(longest_frame) == interface.link.framing.longest_frame(6 + 22 + 4 * 28 + 2)
    *lines, sizes = output(tmp_path, COUNTER, data, interface=interface)
    assert lines == [f"shot {count} of {count} beams, 2164.784 m" for count in range(1, 7)] + ["health"]
    assert int(sizes.split()[-1]) == interface.link.framing.longest_frame(interface.maximum_packet_bytes)


@pytest.mark.parametrize("beams", ["0", "65", "-1"])
def test_a_number_of_beams_that_no_packet_has_is_refused(beams, tmp_path):
    built = compile_c(tmp_path, "", "-c", f"-DLIDAR_MAXIMUM_BEAMS={beams}")
    assert built.returncode != 0
    assert "LIDAR_MAXIMUM_BEAMS must be 1 to 64" in built.stderr


def test_float_holds_the_nearest_single_precision_number(tmp_path):
    program = COUNTER.replace(
        "(double)m.beams[m.beam_count - 1u].range_m", "(double)sizeof m.beams[0].range_m"
    )
    data = b"".join(bytes.fromhex(shot["frame"]) for shot in SHOTS)
    *lines, _ = output(tmp_path, program, data, "-DLIDAR_USE_FLOAT")
    assert [line.split()[-2] for line in lines] == ["4.000"] * len(SHOTS)
    *lines, _ = output(
        tmp_path, COUNTER.replace("%.3f", "%.12f"), stream(default_interface()), "-DLIDAR_USE_FLOAT"
    )
    (single,) = struct.unpack("f", struct.pack("f", 2164.784))
    assert {float(line.split()[-2]) for line in lines if "shot" in line} == {single}


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
    assert output(tmp_path, program, b"", "-DLIDAR_USE_FLOAT") == [*expected, "", "", "", ""]


@pytest.mark.parametrize("name", ["default", "altimeter"])
@pytest.mark.parametrize("option", ["-DLIDAR_USE_FLOAT", "-DANY"])
def test_it_stands_alone(name, option, tmp_path):
    """A freestanding compiler may call the four functions that it asks of every environment, and nothing else."""
    interface, program = default_interface(), SENDS + RECEIVES
    if name == "altimeter":  # it takes no commands
        interface, program = shipped_interface(name), RECEIVES
    built = compile_c(tmp_path, program, "-c", "-O2", "-ffreestanding", option, interface=interface)
    assert built.returncode == 0, built.stderr
    header = (tmp_path / "lidar.h").read_text()
    assert set(re.findall(r"#include <(\w+)\.h>", header)) == {"stdbool", "stddef", "stdint"}
    listed = subprocess.run(["nm", "-u", "main.o"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert set(listed.stdout.split()) - {"U"} <= {"memcpy", "memmove", "memset", "memcmp"}
