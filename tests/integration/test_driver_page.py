"""The page for driver writers: its programs run, its faults match the catalogue, its links lead somewhere."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from textwrap import indent

import pytest
from ruamel.yaml import YAML

import lidar_emu
import lidar_protocol

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "driver.md").read_text(encoding="utf-8")
PACKAGE = Path(lidar_protocol.__file__).parent
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
STRICT = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror"]
SHOTS = json.loads((ROOT / "tests" / "protocol" / "golden.json").read_text(encoding="utf-8"))
STREAM = b"\x55\0" + b"".join(bytes.fromhex(shot["frame"]) for shot in SHOTS)

SNIPPETS = """#include "lidar.h"
#include <stdio.h>
int main(void) {
    const uint8_t sequence = 7u, data[8] = {0u};
    const unsigned id = LIDAR_CAN_ID_BEAM, length = 8u;
%s
    uint8_t command[8];
    const bool is_sent = lidar_pack_can_set_pattern(command, sequence, 1u);
    printf("%%zu %%d %%d %%X\\n", length_of, beam.has_range_m, is_sent, LIDAR_CAN_ID_SET_PATTERN);
    return 0;
}
"""


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def expected() -> bytes:
    return b"".join(
        f"shot {shot['header']['shot']}: {shot['beams'][0]['range_m']:.3f} m\n".encode()
        for shot in SHOTS
        if shot["beams"][0]["range_valid"]
    )


def built(folder: Path, program: str) -> str:
    if COMPILER is None:
        pytest.skip("there is no C compiler on this machine")
    (folder / "main.c").write_text(program)
    subprocess.run([COMPILER, *STRICT, f"-I{PACKAGE}", "main.c", "-o", "main"], cwd=folder, check=True)
    return str(folder / "main")


def test_the_programs_print_every_valid_range(tmp_path: Path) -> None:
    (in_c, *_), (in_python, *_) = blocks("c"), blocks("python")
    for command in ([built(tmp_path, in_c)], [sys.executable, "-c", in_python]):
        done = subprocess.run(command, input=STREAM, capture_output=True, check=True)
        assert done.stdout == expected() != b""


def test_the_pieces_of_c_compile(tmp_path: Path) -> None:
    _, command, can = (block.replace("size_t length", "size_t length_of") for block in blocks("c"))
    reported = subprocess.run(
        [built(tmp_path, SNIPPETS % indent(command + can, "    "))], capture_output=True, check=True
    )
    assert reported.stdout == b"14 1 1 132\n"


def test_the_piece_of_python_runs() -> None:
    _, command = blocks("python")
    names = {
        "Host": lidar_protocol.Host,
        "default_interface": lidar_protocol.default_interface,
        "sequence": 7,
    }
    exec(command, names)
    (heard,) = lidar_protocol.CommandReader(lidar_protocol.default_interface()).feed(names["frame"])  # type: ignore[arg-type]
    assert isinstance(heard, lidar_protocol.Command)
    assert (heard.name, heard.sequence, heard.values) == ("set_pattern", 7, {"pattern": 1})


def test_every_fault_of_the_checklist_can_be_ordered() -> None:
    ordered = re.findall(r"`(\{kind: .*?\})`", PAGE)
    assert len(ordered) >= 15
    faults = YAML(typ="safe", pure=True).load("[" + ", ".join(ordered) + "]")
    scenario = lidar_emu.load("descent.yaml", {"faults": "[" + ", ".join(ordered) + "]"})
    assert [fault.kind for fault in scenario.faults] == [fault["kind"] for fault in faults]


@pytest.mark.parametrize("page", ["docs/driver.md", "examples/receivers/README.md"])
def test_its_links_lead_somewhere(page: str) -> None:
    path = ROOT / page
    for target in re.findall(r"\]\(([^)#]+)", path.read_text(encoding="utf-8")):
        assert (path.parent / target).exists(), target
