"""Write an FMU: a description, a library that is compiled here, its sources, and the scenario."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from uuid import NAMESPACE_URL, uuid5
from zipfile import ZIP_DEFLATED, ZipFile

from lidar_emu.errors import Finding, InputError, RunError
from lidar_emu.files import whole_file
from lidar_emu.fmu.model_description import IDENTIFIER, SOURCES, model_description
from lidar_emu.fmu.variables import given_variables, measured_variables
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.shots.model import build_model
from lidar_emu.wire import interface_named
from lidar_protocol import Interface

_HEADERS = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
_WANTED = ("range_m", "closing_speed_mps", "range_valid", "speed_valid")
_COMPILERS = ("cc", "gcc", "clang")


def write_fmu(scenario: FlightScenario, path: Path) -> None:
    """Write an FMU of FMI 2.0 for co-simulation on this machine.

    Args:
        scenario: what the lidar and its site are; its trajectory is replaced by the simulator's truth.
        path: file to write.

    Raises:
        InputError: the interface lacks ranges, speeds or their validity, the machine has no compiler, or the path
            cannot be written.
        RunError: the compiler failed.
    """
    _check_interface(interface_named(scenario.wire.interface, "scenario", "wire.interface"))
    compiler = next(filter(None, map(shutil.which, _COMPILERS)), None)
    if compiler is None or sys.platform != "linux":
        found = Finding("no C compiler" if sys.platform == "linux" else f"the system {sys.platform}")
        raise InputError(
            "fmu", None, found, "allowed: Linux, with cc (on Debian and Ubuntu: apt install gcc)"
        )
    live = scenario if scenario.live else scenario.with_({"trajectory": _LIVE})
    beam_count = build_model(live).beam_count
    stored = json.dumps({"scenario": live.model_dump(mode="json"), "beam_count": beam_count}, indent=1)
    guid = f"{{{uuid5(NAMESPACE_URL, stored)}}}"
    given, measured = given_variables(), measured_variables(beam_count)
    starts = ", ".join(repr(variable.start) for variable in (*given, *measured))
    config = (
        f'#define LIDAR_GUID "{guid}"\n#define LIDAR_GIVEN {len(given)}\n#define LIDAR_MEASURED {len(measured)}\n'
        f"#define LIDAR_START_VALUES {starts}\n"
    )
    step_s = scenario.timing.period_ns * 1e-9
    sources = {"config.h": config.encode()} | {
        name: (files("lidar_emu.fmu") / "source" / name).read_bytes() for name in (*SOURCES, *_HEADERS)
    }
    library = _compiled(compiler, sources)
    with whole_file(path) as file, ZipFile(file, "w", ZIP_DEFLATED) as archive:
        archive.writestr(
            "modelDescription.xml", model_description(scenario.name, guid, [*given, *measured], step_s)
        )
        archive.writestr(f"binaries/linux64/{IDENTIFIER}.so", library)
        for name, content in sources.items():
            archive.writestr(f"sources/{name}", content)
        archive.writestr("resources/scenario.json", stored)
        archive.writestr("resources/python", sys.executable)


_LIVE = {"kind": "live", "listen": "udp:127.0.0.1:5600"}
"""The trajectory in the FMU; nothing listens, since its process takes truth from the library alone."""


def _check_interface(interface: Interface) -> None:
    missing = [name for name in _WANTED if name not in interface.packet.names]
    if missing:
        found = Finding(f"no {', '.join(missing)}")
        raise InputError("scenario", "wire.interface", found, f"allowed: beams with {', '.join(_WANTED)}")


def _compiled(compiler: str, sources: dict[str, bytes]) -> bytes:
    with TemporaryDirectory() as name:
        folder = Path(name)
        for file, content in sources.items():
            (folder / file).write_bytes(content)
        command = [compiler, "-std=gnu11", "-O2", "-fPIC", "-shared", "-o", "library.so", *SOURCES]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RunError(f"{compiler} failed: {(done.stderr.splitlines() or ['no message'])[0]}")
        return (folder / "library.so").read_bytes()
