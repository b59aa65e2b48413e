"""Kaitai Struct: the specification of an interface, compiled to Python and to C++, and the packets that both read."""

from __future__ import annotations

import atexit
import functools
import importlib.util
import io
import json
import os
import shutil
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import IO, Any, cast

import pytest
from ruamel.yaml import YAML
from waiting import LIMIT_S

from lidar_icd import kaitai, kaitai_processes
from lidar_protocol.definitions import Interface
from lidar_protocol.fields import Number, Real
from lidar_protocol.layout import Layout

_SUPPORT = Path(__file__).parent
_MODULES = _SUPPORT.parents[1] / "build" / "node" / "node_modules"
RUNTIME = _SUPPORT / "kaitai_runtime"
"""A stand-in for the library of compiled code in C++."""
_FLAGS = "-std=c++11", "-Wall", "-Wno-sign-compare"

Values = dict[str, Any]


@dataclass
class Packet:
    """What compiled code reads of a packet; None for no value."""

    kind: str
    unit: int
    crc: int
    values: Values
    beams: list[Values]


def require_compiler() -> None:
    """Skip the test where the compiler is not installed."""
    if shutil.which("node") is None:
        pytest.skip("not installed: node")
    if not (_MODULES / "kaitai-struct-compiler").is_dir():
        pytest.skip("not installed: kaitai-struct-compiler in build/node, which `make integrations` installs")


def compiled(text: str, language: str, folder: Path) -> None:
    """Compile a specification into a folder."""
    for name, source in _sources(text, language).items():
        (folder / name).write_text(source, encoding="utf-8")


@functools.cache
def _sources(text: str, language: str) -> dict[str, str]:
    """Compiled files by their names. YAML 1.1 and 1.2 must read the same in the specification."""
    trees = []
    for version in ("1.1", "1.2"):
        yaml = YAML(typ="safe", pure=True)
        yaml.version = version  # type: ignore[assignment]
        trees.append(yaml.load(io.StringIO(text)))
    assert trees[0] == trees[1]
    to_compiler, from_compiler = _compiler()
    print(json.dumps([language, trees[0]]), file=to_compiler, flush=True)
    answer = json.loads(from_compiler.readline())
    assert "error" not in answer, answer["error"]
    return cast("dict[str, str]", answer["files"])


@functools.cache
def _compiler() -> tuple[IO[str], IO[str]]:
    """The input and the output of one compiler for all specifications: it takes half a second to start."""
    node = subprocess.Popen(
        ["node", _SUPPORT / "kaitai_compile.js"],
        env={**os.environ, "NODE_PATH": str(_MODULES)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    atexit.register(node.communicate)
    assert node.stdin is not None
    assert node.stdout is not None
    return node.stdin, node.stdout


def write_processes(interface: Interface, folder: Path) -> None:
    """Write the files that compiled code needs beside it."""
    for name, text in kaitai_processes(interface).items():
        (folder / name).write_text(text, encoding="utf-8")


def stream_class(interface: Interface, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The class LidarStream of an interface, in Python."""
    compiled(kaitai(interface), "python", folder)
    write_processes(interface, folder)
    monkeypatch.syspath_prepend(str(folder))
    return imported(folder / "lidar_stream.py").LidarStream


def imported(path: Path) -> ModuleType:
    """A module, imported anew whatever has its name."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def contents(stream: Any) -> list[Any]:
    """What the frames hold that are not empty."""
    return [frame.content for frame in stream.frames if frame.content.packet is not None]


def read_in_python(interface: Interface, packets: Iterable[Any]) -> list[Packet]:
    """Values of packets."""
    found = []
    for packet in packets:
        kind, body = packet.header.kind.name, packet.body
        block = body.command if kind == "command" else body
        layout = layouts(interface)[f"command_{body.header.code}" if kind == "command" else kind]
        beams = [of_block(interface.packet.beam, beam) for beam in getattr(body, "beams", [])]
        unit, crc = getattr(packet.header, "unit", 0), getattr(packet, "crc", 0)
        found.append(Packet(kind, unit, crc, of_block(layout, block), beams))
    return found


def of_block(layout: Layout | None, block: Any) -> Values:
    """Values of a block by the keys of its fields; codes of enumerations as numbers."""
    assert layout is not None
    return {placed.field.key: getattr(block, placed.field.key) for placed in layout.placed}


def layouts(interface: Interface) -> Mapping[str, Layout]:
    """Layout of each kind of body, of a command by its code."""
    found = {"measurement": interface.packet.header}
    for kind, layout in (("acknowledge", interface.acknowledge), ("housekeeping", interface.housekeeping)):
        if layout is not None:
            found[kind] = layout
    for command in interface.commands.commands if interface.commands else ():
        found[f"command_{command.code}"] = command.packet
    return found


def read_in_cpp(interface: Interface, stream: bytes, folder: Path) -> list[Packet]:
    """Values of the packets in a stream, read by a program in C++."""
    program = built(interface, folder)
    (folder / "stream.bin").write_bytes(stream)
    done = subprocess.run(
        [program, folder / "stream.bin"], capture_output=True, text=True, check=False, timeout=LIMIT_S
    )
    assert done.returncode == 0, done.stderr
    return [Packet(**json.loads(line)) for line in done.stdout.splitlines()]


def built(interface: Interface, folder: Path) -> Path:
    """The program that prints each packet of a stream as JSON."""
    compiled(kaitai(interface), "cpp_stl", folder)
    write_processes(interface, folder)
    (folder / "main.cpp").write_text(_main(interface), encoding="utf-8")
    sources = [folder / "main.cpp", folder / "lidar_stream.cpp"]
    command = ["c++", *_FLAGS, f"-I{RUNTIME}", f"-I{folder}", "-o", folder / "read", *sources]
    subprocess.run(command, check=True, timeout=LIMIT_S)
    return folder / "read"


def _main(interface: Interface) -> str:
    bodies = "\n".join(
        f"""        case lidar_stream_t::PACKET_KIND_{kind.upper()}: {{
            {_body(interface, kind)}
            break;
        }}"""
        for kind in _kinds(interface)
    )
    unit = "packet.header()->unit()" if interface.units > 1 else "0"
    crc = "packet.crc()" if interface.link.crc else "0"
    return f"""#include <fstream>
#include <iomanip>
#include <iostream>
#include <iterator>
#include "lidar_stream.h"

static const char *between = "";

template <typename Value> static void put(const char *name, bool has, Value value) {{
    std::cout << between << '"' << name << "\\": ";
    if (has) {{ std::cout << +value; }} else {{ std::cout << "null"; }}
    between = ", ";
}}

static void show(lidar_stream_t::packet_t &packet) {{
    std::cout << "{{\\"unit\\": " << +{unit} << ", \\"crc\\": " << +{crc} << ", ";
    between = "";
    switch (packet.header()->kind()) {{
{bodies}
        default: std::cout << "\\"kind\\": \\"unknown\\", \\"values\\": {{";
    }}
    std::cout << "]}}\\n";
}}

int main(int, char **arguments) {{
    std::ifstream file(arguments[1], std::ios::binary);
    const std::string data((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
    kaitai::kstream io(data);
    lidar_stream_t stream(&io);
    std::cout << std::setprecision(17);
    for (lidar_stream_t::frame_t *frame : *stream.frames()) {{
        if (!frame->content()->_is_null_packet()) {{ show(*frame->content()->packet()); }}
    }}
}}
"""


def _kinds(interface: Interface) -> Sequence[str]:
    named = {kind.split("_")[0] for kind in layouts(interface)}
    return [kind for kind in ("measurement", "acknowledge", "housekeeping", "command") if kind in named]


def _body(interface: Interface, kind: str) -> str:
    """Statements that print the values of a kind of packet."""
    body = {"command": "telecommand"}.get(kind, kind)
    lines = [
        f'std::cout << "\\"kind\\": \\"{kind}\\", \\"values\\": {{";',
        f"auto body = static_cast<lidar_stream_t::{body}_t *>(packet.body()); (void)body;",
    ]
    if kind == "command":
        for command in interface.commands.commands if interface.commands else ():
            own = f"static_cast<lidar_stream_t::telecommand_{command.name}_t *>(body->command())"
            puts = " ".join(_puts(command.packet, "own"))
            lines.append(f"if (body->header()->code() == {command.code}) {{ auto own = {own}; {puts} }}")
    else:
        lines += _puts(layouts(interface)[kind], "body")
    lines.append('std::cout << "}, \\"beams\\": [";')
    if kind == "measurement" and interface.packet.beam is not None:
        puts = " ".join(_puts(interface.packet.beam, "beam"))
        before = 'std::cout << first << "{"; first = ", "; between = "";'
        lines += ['const char *first = "";', "for (lidar_stream_t::beam_t *beam : *body->beams()) {"]
        lines += [before, puts, 'std::cout << "}";', "}"]
    return "\n            ".join(lines)


def _puts(layout: Layout, block: str) -> list[str]:
    made = []
    for placed in layout.placed:
        codec, key = placed.field.codec, placed.field.key
        may_miss = isinstance(codec, Real) or (isinstance(codec, Number) and not codec.is_full)
        has = f"{block}->has_{key}()" if may_miss else "true"
        made.append(f'put("{key}", {has}, {block}->{key}());')
    return made
