"""Programs in C on the generated header, compiled as strictly as compilers go."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import lidar_icd
from lidar_protocol.definitions import Interface

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang") or ""
NEEDS_COMPILER = pytest.mark.skipif(not COMPILER, reason="there is no C compiler on this machine")
SANITIZERS = "-fsanitize=undefined,address"
STRICT = [
    "-std=c99",
    "-pedantic",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-Wconversion",
    "-Wdouble-promotion",
]
_FORMATS = {
    "bool": ("%d", "int"),
    "int64_t": ("%lld", "long long"),
    "uint64_t": ("%llu", "unsigned long long"),
}
_READER = r"""
int main(void) {
    static lidar_receiver receiver;
    int byte;
    while ((byte = getchar()) != EOF) {
        lidar_feed(&receiver, (uint8_t)byte);
        while (lidar_next(&receiver)) {
            unsigned unit;
%s
        }
    }
    return 0;
}
"""


def compiled(
    folder: Path, interface: Interface, program: str, *flags: str
) -> subprocess.CompletedProcess[str]:
    """Compile a program that includes the interface's header."""
    (folder / "lidar.h").write_text(lidar_icd.c_header(interface))
    (folder / "main.c").write_text('#include "lidar.h"\n' + program)
    command = [COMPILER, *STRICT, *flags, "main.c"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def built(folder: Path, interface: Interface, program: str, *flags: str) -> Callable[[bytes], str]:
    """What runs a program on some input, under sanitizers, and returns its output."""
    done = compiled(folder, interface, "#include <stdio.h>\n" + program, "-o", "main", SANITIZERS, *flags)
    assert done.returncode == 0, done.stderr
    return lambda data: subprocess.run(
        [folder / "main"], input=data, capture_output=True, check=True
    ).stdout.decode()


def read(folder: Path, interface: Interface, stream: bytes, *flags: str) -> list[dict[str, Any]]:
    """Messages that the header reads from a stream: every member of its structs, those of beams with `_K`."""
    header = lidar_icd.c_header(interface)
    kinds = [_printed("measurement", _members(header, "shot"), _members(header, "beam"))]
    kinds += [
        _printed(kind, _members(header, kind))
        for kind in ("acknowledge", "housekeeping")
        if f"lidar_read_{kind}" in header
    ]
    output = built(folder, interface, _READER % "".join(kinds), *flags)(stream)
    return [json.loads(line) for line in output.splitlines()]


def _members(header: str, block: str) -> list[tuple[str, str]]:
    found = re.search(rf"typedef struct {{([^}}]*)}} lidar_{block};", header)
    return re.findall(r"^ *(\w+) (\w+);", found[1], re.MULTILINE) if found else []


def _printed(kind: str, members: list[tuple[str, str]], of_beam: list[tuple[str, str]] | None = None) -> str:
    place = "m.shot." if kind == "measurement" else "m."
    lines = [
        "static lidar_" + kind + " m;",
        f"if (lidar_read_{kind}(receiver.packet, receiver.packet_length, &unit, &m)) {{",
        f'printf("{{\\"kind\\": \\"{kind}\\", \\"unit\\": %u", unit);',
        *_prints(members, place, ""),
    ]
    if of_beam:
        lines += ["for (size_t k = 0u; k < m.beam_count; k++) {", *_prints(of_beam, "m.beams[k].", "k"), "}"]
    return "{\n" + "\n".join([*lines, 'printf("}\\n");', "}"]) + "\n}\n"


def _prints(members: list[tuple[str, str]], place: str, index: str) -> list[str]:
    names = {name for _, name in members}
    key, argument = ("_%u", f"(unsigned){index}, ") if index else ("", "")
    lines = []
    for kind, name in members:
        if name.startswith("has_"):
            continue
        conversion, c_type = _FORMATS.get(kind, ("%.17g", "double"))
        line = f'printf(", \\"{name}{key}\\": {conversion}", {argument}({c_type}){place}{name});'
        if f"has_{name}" in names:
            missing = f'printf(", \\"{name}{key}\\": null"{", (unsigned)" + index if index else ""});'
            line = f"if ({place}has_{name}) {{ {line} }} else {{ {missing} }}"
        lines.append(line)
    return lines
