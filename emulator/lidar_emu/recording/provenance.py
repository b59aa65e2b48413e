"""Provenance of a recording: the resolved run, and the software and processor that computed it."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Iterator
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

from lidar_emu._version import __version__
from lidar_emu.files import read_bytes
from lidar_emu.runtime.options import RunOptions
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_protocol import SHIPPED

_LIBRARIES = ("numpy", "scipy", "numba", "llvmlite")
_CPU = Path("/proc/cpuinfo")
_MOST_INTERFACE_BYTES = 1_000_000


def provenance(scenario: FlightScenario | BenchScenario, options: RunOptions) -> dict[str, str]:
    """Metadata of a recording: values are text or JSON.

    Args:
        scenario: scenario of the run.
        options: options of the run.
    """
    text, interface = scenario.model_dump_json(), interface_text(scenario.wire.interface)
    return {
        "version": __version__,
        "build": json.dumps(build()),
        "seed": str(scenario.seed),
        "scenario": text,
        "scenario_sha256": _sha256(text.encode()),
        "files_sha256": json.dumps(dict(hashed_files(scenario))),
        "interface": interface,
        "interface_sha256": _sha256(interface.encode()),
        "port_options": json.dumps(options.port.to_json()),
        "pace": str(options.pace),
    }


def build() -> dict[str, str]:
    """Versions and processor, on which the bits of a measurement depend besides the scenario."""
    libraries = {name: version(name) for name in _LIBRARIES}
    python = f"{platform.python_implementation()} {platform.python_version()}"
    return {"lidar-emu": __version__, "python": python, **libraries, "processor": _processor()}


def hashed_files(scenario: FlightScenario | BenchScenario) -> Iterator[tuple[str, str]]:
    """Yield each file that the scenario names, with its SHA-256."""
    for name in sorted(_named_files(scenario.model_dump(mode="json"))):
        if Path(name).is_file():
            with Path(name).open("rb") as file:
                yield name, hashlib.file_digest(file, "sha256").hexdigest()


def interface_text(name: str) -> str:
    """Text of the interface definition that a scenario names."""
    if name in SHIPPED:
        return (files("lidar_protocol") / f"{name}.toml").read_text(encoding="utf-8")
    return read_bytes(Path(name), _MOST_INTERFACE_BYTES, "must be a TOML file").decode("utf-8")


def _named_files(node: Any) -> set[str]:
    if isinstance(node, list):
        return set().union(*map(_named_files, node))
    if not isinstance(node, dict):
        return set()
    own = {node["file"]} if isinstance(node.get("file"), str) else set()
    return own.union(*map(_named_files, node.values()))


def _processor() -> str:
    try:
        models = [
            line.partition(":")[2].strip() for line in _CPU.read_text().splitlines() if "model name" in line
        ]
    except OSError:
        models = []
    return " ".join((platform.machine(), *models[:1]))


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
