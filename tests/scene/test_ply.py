"""PLY files in each of their forms; what is damaged is refused rather than read as a smaller mesh."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from lidar_emu.errors import InputError
from lidar_emu.scene.mesh.ply import read_ply

CORNERS = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.5), (0.0, 1.0, 0.5), (0.5, 2.0, 1.0)]
FACES = [(0, 1, 2, 3), (3, 2, 4), (0, 1, 2), (4, 3, 0)]
TRIANGLES = [(0, 1, 2), (0, 2, 3), (3, 2, 4), (0, 1, 2), (4, 3, 0)]
HEADER = """ply
format {format} 1.0
comment by hand
element vertex 5
property float x
property uchar red
property double y
property float32 z
element strip 2
property list ushort short index
element face 4
property float quality
property list uchar int vertex_indices
property list int8 float32 texcoord
end_header
"""
STRIPS = [(7,), (8, 9)]
TEXTURE = [(0.5, 0.25), (), (0.0,), (1.0,)]


def text() -> bytes:
    lines = [f"{x} 9 {y} {z}" for x, y, z in CORNERS]
    lines += [" ".join(map(str, (len(strip), *strip))) for strip in STRIPS]
    for face, texture in zip(FACES, TEXTURE, strict=True):
        lines.append(" ".join(map(str, (0.5, len(face), *face, len(texture), *texture))))
    return (HEADER.format(format="ascii") + "\n".join(lines) + "\n").encode()


def binary(order: str) -> bytes:
    name = "binary_little_endian" if order == "<" else "binary_big_endian"
    data = HEADER.format(format=name).encode()
    for x, y, z in CORNERS:
        data += struct.pack(f"{order}fBdf", x, 9, y, z)
    for strip in STRIPS:
        data += struct.pack(f"{order}H{len(strip)}h", len(strip), *strip)
    for face, texture in zip(FACES, TEXTURE, strict=True):
        data += struct.pack(f"{order}fB{len(face)}i", 0.5, len(face), *face)
        data += struct.pack(f"{order}b{len(texture)}f", len(texture), *texture)
    return data


FILES = {"text": text(), "little-endian": binary("<"), "big-endian": binary(">")}


def refusal(path: Path, content: bytes) -> str:
    path.write_bytes(content)
    with pytest.raises(InputError) as refused:
        read_ply(path)
    line = str(refused.value)
    assert line.startswith(f"{path}: ")
    return line


@pytest.mark.parametrize("name", FILES)
def test_polygons_of_several_sizes_beside_other_properties_are_read(tmp_path: Path, name: str) -> None:
    (tmp_path / "m.ply").write_bytes(FILES[name])
    mesh = read_ply(tmp_path / "m.ply")
    np.testing.assert_array_equal(mesh.vertex, CORNERS)
    np.testing.assert_array_equal(mesh.face, TRIANGLES)


def test_other_line_ends_and_names_are_read(tmp_path: Path) -> None:
    for content in (
        FILES["text"].replace(b"\n", b"\r\n"),
        FILES["text"].replace(b"vertex_indices", b"vertex_index"),
    ):
        (tmp_path / "m.ply").write_bytes(content)
        np.testing.assert_array_equal(read_ply(tmp_path / "m.ply").face, TRIANGLES)


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_ends_early_or_late_is_refused(tmp_path: Path, name: str) -> None:
    content = FILES[name]
    begin = content.index(b"end_header\n") + len(b"end_header\n")
    # A text may lose its last line end, and the last digits of its last number.
    for length in range(begin, len(content) - 4):
        refusal(tmp_path / "m.ply", content[:length])
    assert "more numbers than the header states" in refusal(tmp_path / "m.ply", content + b"\n3 0 1 2 0\n")


def test_a_text_with_fewer_corners_than_it_states_is_refused(tmp_path: Path) -> None:
    line = refusal(
        tmp_path / "m.ply", FILES["text"].replace(b"0.5 4 0 1 2 3 2 0.5 0.25", b"0.5 4 0 1 2 2 0.5 0.25")
    )
    assert "use an intact PLY file" in line


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b"ply\n", b"plz\n", "no PLY header"),
        (b"end_header", b"end", "no PLY header"),
        (b"format ascii 1.0", b"comment", "line 4: must be a line of a PLY header"),
        (b"format ascii 1.0", b"format ascii 2.0", "line 2: must be a line of a PLY header"),
        (b"element vertex 5", b"element vertex -5", "line 4: must be a line of a PLY header"),
        (b"element vertex 5", b"element vertex 999999999999999", "ends within the 999999999999999 rows"),
        (b"element vertex 5", b"element corner 5", "no vertices with x, y and z"),
        (b"property float quality", b"property half quality", "line 12: must be a line of a PLY header"),
        (b"property float x", b"property list uchar float x", "in element"),
        (b"property double y", b"property double z", "z twice in the header"),
        (b"element strip 2", b"element vertex 2", "vertex twice in the header"),
        (b"vertex_indices", b"vertices", "faces of fewer than three vertices, or none"),
        (b"0.5 4 0 1 2 3", b"0.5 -1 0 1 2 3", "a list of -1 in element face"),
        (b"0.5 4 0 1 2 3", b"0.5 nan 0 1 2 3", "a list of nan in element face"),
        (b"0.5 4 0 1 2 3", b"0.5 1e300 0 1 2 3", "a list of 1e+300 in element face"),
        (b"0.5 4 0 1 2 3", b"0.5 4 0 1 2 2.7", "no numbers of vertices"),
        (b"0.5 4 0 1 2 3", b"0.5 4 0 1 2 inf", "no numbers of vertices"),
        (b"0.5 4 0 1 2 3", b"0.5 4 0 1 2 x", "unreadable, could not convert"),
        (b"0.5 4 0 1 2 3", b"0.5 4 0 1 2 5", "a face with vertex 5 of 5, counted from 0"),
    ],
)  # fmt: skip
def test_what_is_no_intact_file_is_refused(tmp_path: Path, old: bytes, new: bytes, words: str) -> None:
    assert old in FILES["text"]
    assert words in refusal(tmp_path / "m.ply", FILES["text"].replace(old, new, 1))


@pytest.mark.parametrize(
    "header", ["", "element vertex 3\nelement face 2\n", "element vertex 0\nproperty float x\n"]
)
def test_a_header_without_a_mesh_is_refused(tmp_path: Path, header: str) -> None:
    refusal(tmp_path / "m.ply", f"ply\nformat ascii 1.0\n{header}end_header\n".encode())
