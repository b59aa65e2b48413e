"""Write an FMU: a description, a library that is compiled here, its sources, and the scenario."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal
from uuid import NAMESPACE_URL, uuid5
from zipfile import ZIP_DEFLATED, ZipFile

from lidar_emu.errors import Finding, InputError, RunError
from lidar_emu.files import whole_file
from lidar_emu.fmu.model_description import (
    FMI2,
    FMI3,
    IDENTIFIER,
    Standard,
    Unit,
    given_variables,
    measured_variables,
    start_values,
)
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.shots.model import build_model
from lidar_emu.wire import interface_named
from lidar_protocol import Interface

_WANTED = ("range_m", "closing_speed_mps", "range_valid", "speed_valid")
_COMPILERS = ("cc", "gcc", "clang")
_LIBRARY = "library.so"
_OPTIONS = ("-std=gnu11", "-O2", "-fPIC", "-fvisibility=hidden", "-shared", "-o", _LIBRARY)
_STANDARDS = {"2": FMI2, "3": FMI3}


def write_fmu(scenario: FlightScenario, path: Path, version: Literal["2", "3"]) -> None:
    """Write an FMU for co-simulation on this machine.

    Args:
        scenario: what the lidar and its site are; its trajectory is replaced by the simulator's truth.
        path: file to write.
        version: version of FMI.

    Raises:
        InputError: the interface lacks ranges, speeds or their validity, the machine has no compiler, or the path
            cannot be written.
        RunError: the compiler failed.
    """
    _check_interface(interface_named(scenario.wire.interface, "scenario", "wire.interface"))
    compiler = next(filter(None, map(shutil.which, _COMPILERS)), None)
    if compiler is None or sys.platform != "linux":
        found = Finding("no C compiler" if sys.platform == "linux" else f"the system {sys.platform}")
        raise InputError("fmu", None, found, "use Linux, with cc (on Debian and Ubuntu: apt install gcc)")
    live = scenario if scenario.live else scenario.with_({"trajectory": _LIVE})
    beam_count = build_model(live).beam_count
    stored = json.dumps({"scenario": live.model_dump(mode="json"), "beam_count": beam_count}, indent=1)
    unit = Unit(
        name=scenario.name,
        token=f"{{{uuid5(NAMESPACE_URL, version + stored)}}}",
        step_s=scenario.timing.period_ns * 1e-9,
        given=tuple(given_variables()),
        measured=tuple(measured_variables(beam_count)),
    )
    standard = _STANDARDS[version]
    sources = {"config.h": _config(unit, standard).encode()} | {
        name: (files("lidar_emu.fmu") / "source" / name).read_bytes()
        for name in (*standard.sources, *standard.headers)
    }
    library = _compiled([compiler, *_OPTIONS, *standard.sources], sources)
    contents: dict[str, bytes | str] = {
        **standard.descriptions(unit),
        f"binaries/{standard.platform}/{IDENTIFIER}.so": library,
        **{f"sources/{name}": content for name, content in sources.items()},
        "resources/scenario.json": stored,
        "resources/python": sys.executable,
    }
    with whole_file(path) as file, ZipFile(file, "w", ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(name, content)


_LIVE = {"kind": "live", "listen": "udp:127.0.0.1:5600"}
"""The trajectory in the FMU; nothing listens, since its process takes truth from the library alone."""


def _check_interface(interface: Interface) -> None:
    missing = [name for name in _WANTED if name not in interface.packet.names]
    if missing:
        found = Finding(f"no {', '.join(missing)}")
        raise InputError(
            "scenario", "wire.interface", found, f"name one whose beams have {', '.join(_WANTED)}"
        )


def _config(unit: Unit, standard: Standard) -> str:
    """`config.h`: the variables, see `lidar.h`."""
    variables = standard.variables(unit)
    table = [
        f"{{{variable.kind.upper()}, {0 if index else len(variable.starts)}, {value!r}}}"
        for variable in variables
        for index, value in enumerate(variable.starts)
    ]
    given, measured = (len(start_values(each)) for each in (unit.given, unit.measured))
    return (
        f'#define LIDAR_TOKEN "{unit.token}"\n'
        f"#define LIDAR_GIVEN {given}\n"
        f"#define LIDAR_MEASURED {measured}\n"
        f"#define LIDAR_PLACES {len(table)}\n"
        f"#define LIDAR_TABLE {', '.join(table)}\n"
    )


def _compiled(command: list[str], sources: dict[str, bytes]) -> bytes:
    with TemporaryDirectory() as name:
        folder = Path(name)
        for file, content in sources.items():
            (folder / file).write_bytes(content)
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RunError(f"{command[0]} failed: {(done.stderr.splitlines() or ['no message'])[0]}")
        return (folder / _LIBRARY).read_bytes()
