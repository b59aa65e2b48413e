"""Requirements on every reader of a user's files, for any bytes: a value, or an `InputError` of one line that names the
file, within bounded memory and without a warning. Each target is a function of the file's bytes, or of changes of an
intact file where its format is large.
"""

from __future__ import annotations

import resource
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from math import pi
from pathlib import Path

import numpy as np

from lidar_emu.beams.flight import build_trajectory
from lidar_emu.campaign.description import read_campaign
from lidar_emu.cli.options import load_scenario
from lidar_emu.errors import InputError
from lidar_emu.scenario.schema import Wire
from lidar_emu.scenario.site import ElevationGrid
from lidar_emu.scenario.trajectory import Table
from lidar_emu.scene.mesh.file import read_mesh
from lidar_emu.scene.terrain.read import read_terrain
from lidar_emu.wire import Encoder, interface_named
from lidar_icd import c_header, dbc, dissector, example, has_xtce, interface_markdown, xtce
from lidar_protocol import Device, Message, SerialReceiver

_MOST_BYTES = 1 << 30
"""Memory that a file of some kilobytes may take."""
_TIMES = {"column": "t", "unit": "s"}
_COLUMNS = {
    "east": {"column": "e", "unit": "km"},
    "up": {"column": "u", "unit": "m", "rate_column": "v", "rate_unit": "m/s"},
    "maximum_gap_s": 1e6,
}
_TABLES = (
    {"up": {"column": "u", "unit": "m"}},
    _COLUMNS | {"yaw": {"column": "y", "unit": "deg"}, "pitch": {"column": "p", "unit": "rad"}},
    _COLUMNS
    | {
        "quaternion": {"columns": ["qw", "qx", "qy", "qz"]},
        "body_rates": {"columns": ["y", "p", "u"], "unit": "deg/s"},
    },
)
_FOLDER = tempfile.TemporaryDirectory()


def trajectory(data: bytes) -> None:
    """Fuzz the CSV file of a flight, with each choice of columns."""
    for keys in _TABLES:
        with _file("t.csv", data) as path:
            part = {"kind": "table", "file": str(path), "time": _TIMES, **keys}
            flight = build_trajectory(Table.model_validate(part, strict=False))
            state = flight.state(np.linspace(0.0, flight.duration_s, 9))
            assert all(np.isfinite(column).all() for column in state)


def points(data: bytes) -> None:
    """Fuzz the text of a point cloud."""
    with _file("p.xyz", data) as path:
        terrain = read_terrain(ElevationGrid(kind="grid", file=str(path), pixel_m=1.0))
        assert np.isfinite(terrain.origin_elevation_m)


def _mesh(suffix: str, data: bytes) -> None:
    with _file(f"m.{suffix}", data) as path:
        mesh = read_mesh(str(path), "km" if suffix == "bds" else "m")
        assert np.isfinite(mesh.corner_m).all()
        assert mesh.description.isprintable()


def dsk(data: bytes) -> None:
    """Fuzz the changes of a DSK: each is a place, a length, and the bytes to write there."""
    content, rest = bytearray(_intact_dsk()), data
    while len(rest) > 3:
        place, length = int.from_bytes(rest[:3]) % len(content), rest[3] % 16
        changed, rest = rest[4 : 4 + length], rest[4 + length :]
        content[place : place + len(changed)] = changed
    _mesh("bds", bytes(content))


@cache
def _intact_dsk() -> bytes:
    """A tetrahedron as SPICE writes it."""
    import spiceypy

    vertex = np.array([[-1.0, -1, -1], [1, 1, -1], [1, -1, 1], [-1, 1, 1]])
    plate = np.array([[1, 2, 3], [1, 4, 2], [1, 3, 4], [2, 4, 3]])
    with tempfile.TemporaryDirectory() as folder:
        path = f"{folder}/intact.bds"
        handle = spiceypy.dskopn(path, "intact", 0)
        index = spiceypy.dskmi2(vertex, plate, 1.0, 1, 10_000, 10_000, 10_000, False, 200_000)
        spiceypy.dskw02(
            handle, 2000433, 1, 2, "IAU_EROS", 1, np.zeros(10), -pi, pi, -pi / 2, pi / 2, 0.5, 2.0, -1e9, 1e9,
            vertex, plate, *index,
        )  # fmt: skip
        spiceypy.dskcls(handle, True)
        return Path(path).read_bytes()


def interface(data: bytes) -> None:
    """Fuzz an interface definition: what can be loaded has documents, and returns its own packets."""
    with _file("i.toml", data) as path:
        read = interface_named(str(path), "--interface")
        for document in (interface_markdown, c_header, dissector):
            assert document(read)
        if read.can is not None:
            assert dbc(read)
        if has_xtce(read):
            assert xtce(read)
        packet = Device(read).serial_bytes(*example.shot(read))
        assert isinstance(SerialReceiver(read).receive(packet)[0], Message)
        for fd in (None, False, True):
            with _refused():
                Encoder(Wire(interface=str(path)), fd is not None, bool(fd), 4)


def scenario(data: bytes) -> None:
    """Fuzz a scenario, and a campaign."""
    with _file("s.yaml", data) as path:
        load_scenario(str(path), None, None, ())
    with _file("c.yaml", data) as path:
        read_campaign(path)


@contextmanager
def _file(name: str, data: bytes) -> Iterator[Path]:
    """A file with this content, whose reader is bounded, and may refuse it."""
    path = Path(_FOLDER.name) / name
    path.write_bytes(data)
    # A scenario may name other files, in which the fault may be.
    with _bounded(), _refused("/" if path.suffix == ".yaml" else str(path)):
        yield path


@contextmanager
def _refused(path: str = "") -> Iterator[None]:
    """Accept an error of one line that begins with this path."""
    line = path
    try:
        yield
    except InputError as error:
        line = str(error)
    assert line.startswith(path), line
    assert line.isprintable(), line


@contextmanager
def _bounded() -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + _MOST_BYTES, hard))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


TARGETS: dict[str, Callable[[bytes], None]] = {
    **{check.__name__: check for check in (trajectory, points, dsk, interface, scenario)},
    **{suffix: partial(_mesh, suffix) for suffix in ("ply", "obj", "stl", "tab")},
}
