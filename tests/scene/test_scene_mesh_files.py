"""Files of meshes: counted right, closed where they should be, and never silently wrong."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest
from twins import ITOKAWA

from lidar_emu.errors import InputError
from lidar_emu.scenario.site import Site
from lidar_emu.scene import build_scene
from lidar_emu.scene.mesh.file import MeshFile, enclosed_m3, read_mesh

CUBE = np.array([[x, y, z] for x in (0.0, 2.0) for y in (0.0, 2.0) for z in (0.0, 2.0)])
QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
"""Faces of the cube, outward, counted from 0."""
TRIANGLES = np.concatenate([QUADS[:, [0, 1, 2]], QUADS[:, [0, 2, 3]]])


def rows(key: str, table: np.ndarray) -> str:
    return "".join(f"{key}{' '.join(map(str, row))}\n" for row in table.tolist())


def written(folder: Path, name: str, text: str) -> str:
    (folder / name).write_text(text)
    return str(folder / name)


def assert_cube(file: MeshFile, side_m: float = 2.0) -> None:
    assert (file.is_closed, file.faces_one_way, file.turned) == (True, True, False)
    assert enclosed_m3(file.corner_m) == pytest.approx(side_m**3, rel=1e-12)
    np.testing.assert_allclose(file.corner_m.max(axis=(0, 1)), side_m)


def refusal(path: str) -> str:
    with pytest.raises(InputError) as refused:
        read_mesh(path, "m")
    assert "\n" not in str(refused.value)
    return str(refused.value)


# OBJ


@pytest.mark.parametrize("faces", [QUADS, TRIANGLES], ids=["quads", "triangles"])
@pytest.mark.parametrize("style", ["{}", "{}/7", "{}//3", "{}/1/2"])
def test_faces_of_any_style_make_the_cube(tmp_path: Path, faces: np.ndarray, style: str) -> None:
    text = rows("v ", CUBE) + "vn 0 0 1\n" * 3
    text += "".join(f"f {' '.join(style.format(k + 1) for k in face)} # a face\n" for face in faces)
    assert_cube(read_mesh(written(tmp_path, "cube.obj", text), "m"))
    crlf = text.replace("\n", "\r\n").replace(" # a face", "").replace("f ", "f \\\r\n ")
    assert_cube(read_mesh(written(tmp_path, "again.obj", crlf), "m"))


def test_negative_indices_count_back_from_the_face(tmp_path: Path) -> None:
    # Every face repeats its own corners, and states them by their distance to the end so far.
    text = "".join(rows("v ", CUBE[face]) + "f -4 -3 -2 -1\n" for face in QUADS)
    assert_cube(read_mesh(written(tmp_path, "cube.obj", text), "m"))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("f 0 1 2", ("line 9: face 0 1 2", "from 1 to 8", "add 1 to all indices")),
        ("f 1 2 9", ("line 9: face 1 2 9", "from 1 to 8")),
        ("f 1/1 2/1 0/1", ("line 9: face 1/1 2/1 0/1", "add 1")),
        ("f -9 1 2", ("line 9: face -9 1 2", "from 1 to 8")),
        ("f 1 2", ("line 9: face 1 2;", "three or more")),
        ("f 1 2 x", ("line 9: face 1 2 x;", "whole vertex numbers")),
        ("f 1 2 3.5", ("line 9: face 1 2 3.5", "whole vertex numbers")),
        ("v 1 2", ("line 9: v 1 2;", "three numbers")),
        ("v 1 2 x", ("line 9: v 1 2 x;", "three numbers")),
        ("v 1 2 1e300", ("beyond 1e+08 m",)),
        ("v 1 2 nan", ("not a number",)),
    ],
)
def test_what_is_no_obj_is_refused_by_its_line(tmp_path: Path, line: str, words: tuple[str, ...]) -> None:
    path = written(tmp_path, "cube.obj", rows("v ", CUBE) + f"{line}\n" + rows("f ", TRIANGLES + 1))
    message = refusal(path)
    assert all(word in message for word in words), message


def test_materials_have_their_own_albedo(tmp_path: Path) -> None:
    text = "mtllib cube.mtl\n" + rows("v ", CUBE)
    text += rows("f ", QUADS[:4] + 1) + "usemtl dark rock\n" + rows("f ", QUADS[4:5] + 1)
    text += "usemtl dust\n" + rows("f ", QUADS[5:] + 1)
    path = written(tmp_path, "cube.obj", text)

    def albedo(**stated: float) -> list[float]:
        ground = {"kind": "mesh", "file": path, "unit": "m", "material_reflectance": stated}
        scene = build_scene(Site.model_validate({"ground": ground, "surface": {"reflectance": 0.2}}))
        # From the west, from below and from above: no material, dark rock, dust.
        origin = np.array([[-5.0, 1.0, 1.0], [1.0, 1.0, -5.0], [1.0, 1.0, 5.0]])
        return scene.cast(origin, np.array([[1.0, 0, 0], [0, 0, 1.0], [0, 0, -1.0]])).reflectance.tolist()

    assert albedo() == [0.2, 0.2, 0.2]
    assert albedo(**{"dark rock": 0.05, "dust": 0.4}) == [0.2, 0.05, 0.4]
    with pytest.raises(
        InputError, match=r"material_reflectance: must be one of dark rock, dust \(got 'rock'\)"
    ):
        albedo(rock=0.1)


# Shape tables


def numbered(table: np.ndarray, first: int) -> np.ndarray:
    return np.column_stack([np.arange(first, first + len(table)), table])


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("style", ["lettered", "counted", "numbered", "head"])
def test_shape_tables_count_from_0_or_1(tmp_path: Path, first: int, style: str) -> None:
    plates = TRIANGLES + first
    text = {
        "lettered": rows("v ", CUBE) + rows("f ", plates),
        "counted": f"8\n{rows('', CUBE)}12\n{rows('', plates)}",
        "numbered": f" 8\n{rows(' ', numbered(CUBE, first).astype(object))} 12\n{rows(' ', numbered(plates, first))}",
        "head": f"8 12\n{rows('', CUBE)}{rows('', plates)}",
    }[style]
    path = written(tmp_path, "cube.tab", text)
    assert_cube(read_mesh(path, "km"), 2000.0)


def test_a_table_that_does_not_show_what_it_counts_from_is_refused(tmp_path: Path) -> None:
    # Neither the first nor the last vertex has a plate.
    text = rows("v ", np.vstack([[9, 9, 9], CUBE, [9, 9, 9]])) + rows("f ", TRIANGLES + 1)
    path = written(tmp_path, "cube.tab", text)
    assert "from 1 to 8; count from 0 or from 1, and use the first or the last vertex" in refusal(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (rows("v ", CUBE) + rows("f ", TRIANGLES + 2), "from 2 to 9; count from 0 or from 1"),
        (rows("v ", CUBE) + rows("f ", TRIANGLES + 0.5), "fractions"),
        (rows("v ", CUBE) + rows("f ", TRIANGLES) + "f 0 1 -1e308\n", "or too large"),
        (rows("v ", CUBE) + rows("f ", TRIANGLES) + "f 0 1 inf\n", "or too large"),
        (f"8\n{rows('', CUBE)}13\n{rows('', TRIANGLES)}", "8 rows of vertices and 12 of plates"),
        (f"9\n{rows('', CUBE)}", "no shape table"),
        ("0 0 1.5\n0 5 1.4\n", "no shape table"),
        ("8\n" + "a b c\n" * 8 + "1\n1 2 3\n", "vertices that are not three numbers"),
        ("", "no shape table"),
    ],
)
def test_tables_that_are_no_shapes_are_refused(tmp_path: Path, text: str, words: str) -> None:
    assert words in refusal(written(tmp_path, "cube.tab", text))


@pytest.mark.parametrize(
    "text", [rows("v ", CUBE[:6, :2]) + "f 1 2 3\n", "6\n" + rows("", CUBE[:6, :2]) + "1\n0 1 2\n"]
)
def test_vertices_of_two_numbers_are_refused(tmp_path: Path, text: str) -> None:
    """Twelve numbers are not four vertices."""
    suffix, words = (
        ("obj", "line 1: v 0.0 0.0;") if text.startswith("v") else ("tab", "vertices that are not three")
    )
    assert words in refusal(written(tmp_path, f"flat.{suffix}", text))


@pytest.mark.parametrize("number", ["1e3080", "1e200", "-1e9"])
@pytest.mark.parametrize("suffix", ["obj", "ply"])
def test_a_polygon_beyond_all_planets_is_refused(tmp_path: Path, suffix: str, number: str) -> None:
    corners = np.array([(0, 0, 0), (4, 0, 0), (1, 1, 0), (0, 77, 0)])
    path = Path(polygon_file(tmp_path, suffix, corners))
    assert "beyond 1e+08 m" in refusal(
        written(tmp_path, f"far.{suffix}", path.read_text().replace("77", number))
    )


# STL


FACET = "facet normal {0} {0} 1\n outer loop\n  vertex {1} 0 0\n  VERTEX 9 0 0\n vertex 0 9 0\n endloop\nendfacet\n"
SOLIDS = f"solid a vertex\n{FACET.format('-nan(ind)', 0)}{FACET.format(0, 1)}endsolid a\n"
SOLIDS += f"solid\n{FACET.format(0, 2)}endsolid\n"


def binary_stl(count: int, stated: int | None = None) -> bytes:
    facet = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 9, 0, 0, 0, 9, 0, 7)
    return b"solid".ljust(80) + struct.pack("<I", count if stated is None else stated) + count * facet


def test_all_solids_of_a_text_are_read(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Some programs write the normals of thin facets as no numbers."""
    file = read_mesh(written(tmp_path, "solids.stl", SOLIDS), "m")
    assert file.corner_m[:, 0, 0].tolist() == [0, 1, 2]
    assert capfd.readouterr() == ("", "")


def test_a_binary_file_is_read_by_its_length(tmp_path: Path) -> None:
    (tmp_path / "b.stl").write_bytes(binary_stl(3))
    assert read_mesh(str(tmp_path / "b.stl"), "m").corner_m.tolist() == 3 * [
        [[0, 0, 0], [9, 0, 0], [0, 9, 0]]
    ]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (SOLIDS.rpartition("endsolid")[0].encode(), "ends within a solid; use an intact STL"),
        (SOLIDS.replace("vertex 2 0 0\n", "").encode(), "line 22: a facet of other than three vertices"),
        (
            SOLIDS.replace("vertex 2 0 0", "vertex 2 0").encode(),
            "line 20: vertex 2 0; write vertex and three numbers",
        ),
        (SOLIDS.replace("vertex 2 0 0", "vertex 2 x 0").encode(), "line 20: vertex 2 x 0"),
        (SOLIDS.replace("outer loop", "").encode(), "line 4: "),
        (binary_stl(3, 4), "neither text nor as long as its facets"),
        (binary_stl(3)[:-1], "neither text"),
        (b"", "neither text"),
        (b"solid\nendsolid\n", "no triangles"),
    ],
)
def test_a_damaged_stl_is_refused(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "bad.stl").write_bytes(content)
    assert words in refusal(str(tmp_path / "bad.stl"))


# Welding


def globe(noise_m: float, radius_m: float = 1000.0) -> str:
    """A sphere by latitude and longitude, with 72 vertices at each pole, and its seam twice; quads, outward."""
    latitude, longitude = np.radians(np.linspace(-90, 90, 37)), np.radians(np.linspace(0, 360, 73))
    north, east = np.meshgrid(latitude, longitude, indexing="ij")
    vertex = radius_m * np.stack(
        [np.cos(north) * np.cos(east), np.cos(north) * np.sin(east), np.sin(north)], axis=-1
    )
    vertex += noise_m * np.random.default_rng(3).uniform(-0.5, 0.5, vertex.shape)
    number = np.arange(north.size).reshape(north.shape) + 1
    quads = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1)
    return rows("v ", vertex.reshape(-1, 3)) + rows("f ", quads.reshape(-1, 4))


@pytest.mark.parametrize("noise_m", [0.0, 1e-9, 1e-3])
def test_a_globe_with_a_vertex_per_longitude_at_its_poles_is_closed(tmp_path: Path, noise_m: float) -> None:
    file = read_mesh(written(tmp_path, "globe.obj", globe(noise_m)), "m")
    assert (file.is_closed, file.faces_one_way) == (True, True)
    assert "welded to nearly equal ones" in file.description
    # A polyhedron within the sphere, a thousandth smaller for each 5 degrees.
    assert enclosed_m3(file.corner_m) == pytest.approx(4 / 3 * math.pi * 1e9, rel=5e-3)
    assert f"volume {enclosed_m3(file.corner_m) / 1e9:.5g} km³" in file.description


def test_a_real_gap_is_not_welded(tmp_path: Path) -> None:
    file = read_mesh(written(tmp_path, "globe.obj", globe(1.0)), "m")
    assert not file.is_closed
    assert file.welded == 0
    assert ", open" in file.description


def test_what_is_welded_leaks_no_ray(tmp_path: Path) -> None:
    ground = {"kind": "mesh", "file": written(tmp_path, "globe.obj", globe(1e-3)), "unit": "m"}
    scene = build_scene(Site.model_validate({"ground": ground}))
    rng = np.random.default_rng(5)
    target = np.column_stack([rng.uniform(-1e-3, 1e-3, (5000, 2)), np.full(5000, 1000.0)])
    way = target - [0.0, 0.0, 5000.0]
    found = scene.cast(np.tile([0.0, 0.0, 5000.0], (5000, 1)), way / np.linalg.norm(way, axis=1)[:, None])
    np.testing.assert_allclose(found.range_m, 4000.0, atol=2e-3)


def polygon_file(folder: Path, suffix: str, corners: np.ndarray) -> str:
    if suffix == "obj":
        return written(
            folder,
            "polygon.obj",
            rows("v ", corners) + f"f {' '.join(map(str, 1 + np.arange(len(corners))))}\n",
        )
    lines = ["ply", "format ascii 1.0", f"element vertex {len(corners)}"]
    lines += [f"property double {axis}" for axis in "xyz"]
    lines += [
        "element face 1",
        "property list uchar int vertex_indices",
        "end_header",
        *rows("", corners).split("\n")[:-1],
    ]
    return written(
        folder,
        "polygon.ply",
        "\n".join([*lines, " ".join(map(str, [len(corners), *range(len(corners))]))]) + "\n",
    )


ARROW = [(0, 0), (4, 0), (1, 1), (0, 4)]
ELL = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)]
CUP = [(0, 0), (5, 0), (5, 4), (4, 4), (4, 1), (1, 1), (1, 4), (0, 4)]
"""No corner sees all others."""


@pytest.mark.parametrize("suffix", ["obj", "ply"])
@pytest.mark.parametrize(("corners", "area_m2"), [(ARROW, 4.0), (ELL, 5.0)])
@pytest.mark.parametrize("first", range(6))
def test_a_concave_polygon_has_ground_where_it_is(
    tmp_path: Path, suffix: str, corners: list[tuple[int, int]], area_m2: float, first: int
) -> None:
    flat = np.roll(np.array(corners, dtype=float), first, axis=0)
    file = read_mesh(polygon_file(tmp_path, suffix, np.column_stack([flat, 0.3 * flat[:, 0]])), "m")
    edges = file.corner_m[:, 1:] - file.corner_m[:, :1]
    areas = 0.5 * np.cross(edges[:, 0], edges[:, 1])[:, 2]
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(area_m2, rel=1e-12)


@pytest.mark.parametrize("suffix", ["obj", "ply"])
@pytest.mark.parametrize("corners", [CUP, [(0, 0), (1, 1), (1, 0), (0, 1)]])
def test_a_polygon_without_a_fan_is_refused(
    tmp_path: Path, suffix: str, corners: list[tuple[int, int]]
) -> None:
    flat = np.array(corners, dtype=float)
    assert "of which one corner sees all others" in refusal(
        polygon_file(tmp_path, suffix, np.column_stack([flat, 0 * flat[:, 0]]))
    )


@pytest.mark.parametrize("index", [-1, -4, 4, 2**31 - 1])
def test_a_vertex_that_a_ply_does_not_have_is_refused(tmp_path: Path, index: int) -> None:
    whole = Path(
        polygon_file(tmp_path, "ply", np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]))
    ).read_text()
    path = written(tmp_path, "wrong.ply", whole.replace("4 0 1 2 3", f"3 0 1 {index}"))
    assert f"a face with vertex {index} of 4, counted from 0" in refusal(path)
    assert "fewer than three vertices" in refusal(
        written(tmp_path, "few.ply", whole.replace("4 0 1 2 3", "2 0 1"))
    )


def test_a_vertex_with_a_weight_is_refused(tmp_path: Path) -> None:
    text = rows("v ", CUBE) + "f 1 2 3\n"
    with_ones = text.replace("\nv", " 1.0\nv")
    assert len(read_mesh(written(tmp_path, "ones.obj", with_ones), "m").corner_m) == 1
    assert "line 1: a vertex of weight 2.0; write x/w y/w z/w" in refusal(
        written(tmp_path, "weights.obj", text.replace("\n", " 2.0\n", 1))
    )


# Real ones


def test_itokawa_in_a_table_is_itokawa(public_data: Path, tmp_path: Path) -> None:
    lines = (public_data / ITOKAWA).read_text().splitlines()
    vertices = [line[2:] for line in lines if line.startswith("v ")]
    plates = [line[2:] for line in lines if line.startswith("f ")]
    text = "\n".join([str(len(vertices)), *vertices, str(len(plates)), *plates])
    file = read_mesh(written(tmp_path, "itokawa.tab", text), "km")
    assert enclosed_m3(file.corner_m) == pytest.approx(0.017786e9, rel=1e-4)
    assert "closed, volume 1.7786e+07 m³, radii" in file.description


@pytest.mark.parametrize("word", ["9" * 30, "9" * 10_000, "x" * 100_000, "1" + 18 * "0", "²"])
def test_an_index_of_any_length_is_refused_by_its_line(tmp_path: Path, word: str) -> None:
    """The faces before it would need 160 GB, if each of their words took the room of the longest."""
    text = rows("v ", CUBE) + "f 1 2 3\n" * 100_000 + f"f 1 2 {word}\n"
    found = refusal(written(tmp_path, "long.obj", text))
    assert "line 100009: face 1 2 " in found
    assert "use whole vertex numbers" in found
