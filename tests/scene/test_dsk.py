"""DSK files are read as SPICE reads them, and damaged ones are refused."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lidar_emu.errors import InputError
from lidar_emu.scene.mesh.dsk import read_dsk
from lidar_emu.scene.mesh.file import enclosed_m3, read_mesh

spiceypy = pytest.importorskip("spiceypy", reason="spiceypy is not installed")

TETRAHEDRON = np.array([[-1.0, -1, -1], [1, 1, -1], [1, -1, 1], [-1, 1, 1]])
PLATES = np.array([[1, 2, 3], [1, 4, 2], [1, 3, 4], [2, 4, 3]])
_HEADER_WORDS = slice(68, 84)
_RECORD = 1024


def globe(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices, and plates that count from 1, of a closed surface of 2 rows² plates."""
    latitude, longitude = np.meshgrid(
        np.linspace(-1.4, 1.4, rows), np.linspace(0, 2 * math.pi, rows, endpoint=False), indexing="ij"
    )
    vertex = np.stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)],
        axis=-1,
    ).reshape(-1, 3)
    k, j = (each.ravel() for each in np.meshgrid(np.arange(rows - 1), np.arange(rows), indexing="ij"))
    a, b = k * rows + j, k * rows + (j + 1) % rows
    plate = np.concatenate([np.stack([a, b, a + rows], axis=-1), np.stack([b, b + rows, a + rows], axis=-1)])
    return vertex, np.ascontiguousarray(plate + 1)


def written(path: Path, *shapes: tuple[np.ndarray, np.ndarray], comments: int = 0) -> Path:
    """Segments as SPICE writes them."""
    handle = spiceypy.dskopn(str(path), "shapes", 0)
    if comments:
        spiceypy.dasac(handle, [f"comment {k}" for k in range(comments)])
    for vertex, plate in shapes:
        index = spiceypy.dskmi2(vertex, plate, 1.0, 2, 1_000_000, 1_000_000, 1_000_000, False, 3_000_000)
        spiceypy.dskw02(
            handle, 2000433, 1, 2, "IAU_EROS", 1, np.zeros(10),
            -math.pi, math.pi, -math.pi / 2, math.pi / 2, 0.1, 9.0, -1e9, 1e9, vertex, plate, *index,
        )  # fmt: skip
    spiceypy.dskcls(handle, True)
    return path


def swapped(content: bytes) -> bytes:
    """A file without comments, of one directory and of one segment, with the highest byte first."""
    made, last = bytearray(content), len(content)
    made[84:92] = b"BIG-IEEE"

    def turn(part: slice, kind: str) -> None:
        made[part] = np.frombuffer(content[part], f"<{kind}").astype(f">{kind}").tobytes()

    turn(_HEADER_WORDS, "i4")
    turn(slice(_RECORD, 2 * _RECORD), "i4")
    directory = np.frombuffer(content, "<i4", 256, _RECORD).tolist()
    integers_first = directory[8] == 3
    middle = (2 + directory[9]) * _RECORD
    turn(slice(2 * _RECORD, middle), "i4" if integers_first else "f8")
    turn(slice(middle, last), "f8" if integers_first else "i4")
    return bytes(made)


def assert_read_as_spice_does(path: Path) -> None:
    mesh, handle = read_dsk(path), spiceypy.dasopr(str(path))
    vertex, face, count = list[Any](), list[Any](), 0
    segment = spiceypy.dlabfs(handle)
    while True:
        vertices, plates = spiceypy.dskz02(handle, segment)
        vertex.append(spiceypy.dskv02(handle, segment, 1, vertices))
        face.append(spiceypy.dskp02(handle, segment, 1, plates) - 1 + count)
        count += vertices
        try:
            segment = spiceypy.dlafns(handle, segment)
        except spiceypy.utils.exceptions.NotFoundError:
            break
    spiceypy.dascls(handle)
    np.testing.assert_array_equal(mesh.vertex, np.concatenate(vertex))
    np.testing.assert_array_equal(mesh.face, np.concatenate(face))


def test_a_dsk_is_a_mesh_in_kilometres(tmp_path: Path) -> None:
    path = written(tmp_path / "four.bds", (TETRAHEDRON, PLATES))
    file = read_mesh(str(path), "km")
    assert (file.is_closed, len(file.corner_m)) == (True, 4)
    assert enclosed_m3(file.corner_m) == pytest.approx(8e9 / 3, rel=1e-12)
    with pytest.raises(InputError, match="must be km, the unit of every DSK"):
        read_mesh(str(path), "m")


@pytest.mark.parametrize("rows", [(4,), (40,), (12, 60, 25), (30, 30, 30, 30)], ids=str)
@pytest.mark.parametrize("comments", [0, 200])
def test_segments_of_any_size_are_read(tmp_path: Path, rows: tuple[int, ...], comments: int) -> None:
    assert_read_as_spice_does(written(tmp_path / "globes.bds", *map(globe, rows), comments=comments))


def test_a_dsk_with_the_highest_byte_first_is_read(tmp_path: Path) -> None:
    little, big = written(tmp_path / "little.bds", (TETRAHEDRON, PLATES)), tmp_path / "big.bds"
    big.write_bytes(swapped(little.read_bytes()))
    assert_read_as_spice_does(big)


DAMAGE = {
    "no DSK": (0, b"text"),
    "no DSK ": (84, b"VAX-GFLT"),
    "no directory": (68, b"\xff\xff\xff\x7f"),
    "no directory ": (1028, b"\x07\0\0\0"),
    "fewer records": (1060, b"\x40\x42\x0f\0"),
    "fewer records ": (1028, b"\x02\0\0\0"),
    "no directory  ": (1028, b"\x02\0\0\0" + bytes(32)),
    "no segment": (3076, b"\xff\xff\xff\x7f"),
}


@pytest.mark.parametrize("found", DAMAGE)
def test_a_damaged_dsk_is_refused(tmp_path: Path, found: str) -> None:
    """CSPICE ends the process for some of these, and reads others for ever."""
    path = written(tmp_path / "four.bds", (TETRAHEDRON, PLATES))
    content, (place, instead) = bytearray(path.read_bytes()), DAMAGE[found]
    content[place : place + len(instead)] = instead
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"four\.bds: .*{found.strip()}.*; use an intact DSK"):
        read_mesh(str(path), "km")


def test_a_dsk_that_ends_early_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "four.bds", (TETRAHEDRON, PLATES))
    content = path.read_bytes()
    for length in range(0, len(content), 92):
        path.write_bytes(content[:length])
        with pytest.raises(InputError, match="use an intact DSK"):
            read_mesh(str(path), "km")
