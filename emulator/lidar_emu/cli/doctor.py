"""`lidar-emu doctor`: what a run needs and can use on this machine, and how to get what is missing."""

from __future__ import annotations

import os
import platform
import re
import socket
from collections.abc import Iterator
from importlib import import_module, metadata
from pathlib import Path
from tempfile import TemporaryFile

import click

from lidar_emu._version import __version__
from lidar_emu.cli.terminal import print_line
from lidar_emu.errors import one_line, reason_of
from lidar_emu.files import cache_folder, pip_install
from lidar_emu.numerics.compilation import ONCE, usable_cores
from lidar_emu.transports.spec import DEFAULT_BITRATE

_OK, _MISSING, _NEEDED = "ok", "missing", "needed"
_Findings = Iterator[tuple[str, str]]
"""State and text. No run is possible without what is needed."""
_USES = {
    "basilisk": "Basilisk in the loop",
    "cluster": "campaigns on Dask",
    "compiler": "kernels that are not precompiled",
    "geo": "maps: GeoTIFF, PDS, ESRI ASCII",
    "live": "run --view foxglove",
    "mesh": "ground --compare",
    "pandas": "runs as data frames",
    "plots": "plots, and figures of reports",
    "points": "point clouds: .las, .laz",
    "ros": ".ros2.mcap for Foxglove, RViz and PlotJuggler",
    "sensitivity": "campaign --sensitivity",
    "tables": "campaigns and Parquet",
    "test": "the pytest plugin",
    "view": "the Rerun viewer",
}
"""Uses of the extras for users; the others hold tools of developers."""
_NETWORKS = Path("/sys/class/net")
_TYPE_OF_CAN = "280"
"""ARPHRD_CAN of Linux."""


@click.command(short_help="Check what this machine has: packages, cache, ports, real time.")
def doctor() -> int:
    """Print a line for each thing that a run needs or can use, with how to get what is missing.

    Exit code 0 if a run is possible, 1 if something that it needs is missing.
    """
    states = set()
    for check in (_packages, _kernels, _can, _serial_ports, _real_time):
        try:
            for state, text in check():
                states.add(state)
                print_line(f"{state:9}{one_line(text)}")
        except Exception as error:  # of whatever is damaged or missing here
            print_line(f"{_MISSING:9}{check.__name__.strip('_').replace('_', ' ')}: {reason_of(error)}")
    print_line("no run is possible" if _NEEDED in states else "a run is possible")
    return int(_NEEDED in states)


def _packages() -> _Findings:
    system = f"{platform.platform()}, {usable_cores()} processors"
    yield _OK, f"lidar-emu {__version__}, Python {platform.python_version()}, {system}"
    for name in ("numpy", "scipy", "numba"):
        try:
            yield _OK, f"{name} {import_module(name).__version__}"
        except Exception as error:
            state = _MISSING if name == "numba" and _precompiled() else _NEEDED
            yield state, f"{name}: pip install {name}; {reason_of(error)}"
    extras: dict[str, dict[str, str | None]] = {}
    for line in metadata.requires("lidar-emu") or []:
        name, extra = re.split(r"[^\w.-]", line)[0], re.search(r"extra == ['\"]([\w-]+)", line)
        found = next(iter(metadata.distributions(name=name)), None)
        if extra and extra[1] in _USES:
            extras.setdefault(extra[1], {})[name] = found.version if found else None
        elif extra is None and found is None and name != "numba":
            yield _NEEDED, f"{name}: pip install {name}"
    for use, versions in extras.items():
        is_there = all(versions.values())
        what = ", ".join(f"{name} {version}" for name, version in versions.items())
        how = what if is_there else pip_install(use)
        yield _OK if is_there else _MISSING, f"extra {use} ({_USES[use]}): {how}"


def _precompiled() -> int:
    from lidar_emu.numerics.lazy_kernel import prebuilt_table

    return len(prebuilt_table())


def _kernels() -> _Findings:
    try:
        folder = Path(os.environ.get("NUMBA_CACHE_DIR") or cache_folder()) / "kernels"
        sizes = [path.stat().st_size for path in folder.glob("[!.]*")]
        TemporaryFile(dir=next(path for path in (folder, *folder.parents) if path.exists())).close()
        yield _OK, f"cache {folder}: {len(sizes)} kernels, {sum(sizes) * 1e-6:.0f} MB, writable"
    except (OSError, RuntimeError) as error:  # not writable, or a user without a home folder
        yield _MISSING, f"cache: set XDG_CACHE_HOME to a folder that you may write; {reason_of(error)}"
    count = _precompiled()
    none = f"none: what is not in the cache is compiled ({ONCE})"
    yield _OK if count else _MISSING, f"precompiled kernels: {count or none}"


def _can() -> _Findings:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except (AttributeError, OSError) as error:
        remedy = "sudo modprobe -a can_raw vcan (Linux), or use -i udp_multicast"
        yield _MISSING, f"CAN in the kernel: {remedy}; {reason_of(error)}"
        return
    types = sorted(_NETWORKS.glob("*/type"))
    networks = [path.parent for path in types if path.read_text().strip() == _TYPE_OF_CAN]
    for network in networks:
        is_up = int((network / "flags").read_text(), 16) & 1 == 1
        bit_rate = "" if network.name.startswith("vcan") else f" type can bitrate {DEFAULT_BITRATE}"
        remedy = f"sudo ip link set {network.name} up{bit_rate}"
        yield _OK if is_up else _MISSING, f"CAN {network.name}: {'up' if is_up else remedy}"
    if not networks:
        yield _MISSING, "CAN interface: sudo ip link add vcan0 type vcan && sudo ip link set vcan0 up"


def _serial_ports() -> _Findings:
    from serial.tools.list_ports import comports

    for port in (ports := comports()):
        if os.name == "nt" or os.access(port.device, os.R_OK | os.W_OK):
            yield _OK, f"serial port {port.device} ({port.description})"
        else:
            remedy = f"sudo usermod -aG {Path(port.device).group()} $USER, then log in again"
            yield _MISSING, f"serial port {port.device} ({port.description}): {remedy}"
    if not ports:
        yield _MISSING, "serial port: an adapter is /dev/ttyUSB0 or /dev/ttyACM0; --port pty needs none"


def _real_time() -> _Findings:
    try:
        from lidar_emu.runtime.realtime_priority import request_realtime
    except ImportError as error:
        yield _NEEDED, f"Linux: run, replay, listen and send need it, other commands do not; {error}"
        return
    found = request_realtime()
    yield _OK, f"real time: {', '.join(found.granted).replace('_', ' ') or 'nothing granted'}"
    for name, remedy in found.missing.items():
        yield _MISSING, f"real time, {name.replace('_', ' ')}: {remedy}"
