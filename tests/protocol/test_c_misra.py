"""The generated C header under the MISRA C:2012 add-on of cppcheck: no rule but advisory ones is broken."""

import shutil
import subprocess

import pytest

import lidar_icd
from lidar_protocol import load, shipped_interface
from lidar_protocol.definition_file import files

DEFAULT = (files("lidar_protocol") / "default.toml").read_text(encoding="utf-8")
ADVISORY = {
    "2.5": "a macro that this program does not use",
    "11.5": "bytes of a value, by way of a pointer to void",
    "12.1": "precedence without parentheses",
    "12.3": "two declarations in a line",
    "13.3": "an increment within an expression",
    "13.4": "the value of an assignment",
    "15.5": "more than one return",
    "17.8": "a parameter that is changed",
    "18.4": "pointer arithmetic",
}
PROGRAM = """#include "lidar.h"
int main(void) {
    static lidar_receiver receiver;
    static lidar_measurement shot;
    unsigned unit;
    lidar_feed(&receiver, 0u);
    return (lidar_next(&receiver) &&
            lidar_read_measurement(receiver.packet, receiver.packet_length, &unit, &shot)) ? 1 : 0;
}
"""
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("cppcheck") is None, reason="not installed: cppcheck"),
]


@pytest.mark.parametrize("framing", ['kind = "cobs"', 'kind = "slip"', "altimeter"])
def test_only_advisory_rules_are_broken(framing, tmp_path):
    interface = shipped_interface("altimeter")
    if framing != "altimeter":
        interface = load(DEFAULT.replace('kind = "cobs"', framing, 1), "mine.toml")
    (tmp_path / "lidar.h").write_text(lidar_icd.c_header(interface))
    (tmp_path / "main.c").write_text(PROGRAM)
    command = ["cppcheck", "--quiet", "--addon=misra", "--std=c99", "--enable=style", "main.c"]
    command += ["--template={id} {file}:{line}", "--suppress=missingIncludeSystem"]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    found = [line for line in ran.stderr.splitlines() if line.startswith("misra-c2012-")]
    broken = {line.split()[0].removeprefix("misra-c2012-"): line for line in found}
    assert "15.5" in broken, ran.stdout + ran.stderr
    assert not {rule: line for rule, line in broken.items() if rule not in ADVISORY}
