"""Triangle meshes: against trying every triangle, against formulas, and at edges and corners."""

import math
from pathlib import Path

import numpy as np
import pytest
from exact_casting import cast_exact
from twins import ITOKAWA

from lidar_emu.errors import InputError
from lidar_emu.numerics.kernels import with_fields
from lidar_emu.scenario.ground import Mesh as MeshPart
from lidar_emu.scenario.site import Body, Site, Sphere
from lidar_emu.scene import build_scene
from lidar_emu.scene.analytic_grounds import PlaneGround
from lidar_emu.scene.mesh.cast import RAY, set_ray
from lidar_emu.scene.mesh.file import enclosed_m3, read_mesh
from lidar_emu.scene.mesh.ground import TriangleMesh, Triangles, place_mesh
from lidar_emu.scene.ray_hits import Hits

trimesh = pytest.importorskip("trimesh")

RNG = np.random.default_rng


def units(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def assert_same(fast: Hits, exact: Hits, atol: float = 1e-10) -> None:
    np.testing.assert_array_equal(fast.inside, exact.inside)
    np.testing.assert_array_equal(fast.object_id, exact.object_id)
    np.testing.assert_allclose(fast.range_m, exact.range_m, rtol=0, atol=atol)
    np.testing.assert_allclose(fast.normal_site, exact.normal_site, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(fast.reflectance, exact.reflectance)


def hills(count: int, seed: int = 1, height_m: float = 2.0) -> np.ndarray:
    """Random heights on a jittered grid, two triangles a cell: (triangles, 3, 3), facing up."""
    rng = RNG(seed)
    east, north = np.meshgrid(np.arange(count, dtype=float), np.arange(count, dtype=float))
    vertex = np.stack([east, north, height_m * rng.random((count, count))], axis=-1)
    vertex[..., :2] += 0.4 * rng.random((count, count, 2))
    a, b, c, d = vertex[:-1, :-1], vertex[:-1, 1:], vertex[1:, 1:], vertex[1:, :-1]
    both = [np.stack(three, axis=-2).reshape(-1, 3, 3) for three in ((a, b, c), (a, c, d))]
    return np.concatenate(both)


@pytest.mark.parametrize("z", [1.0, 1.0 - 1e-12, 0.5, 0.0, -0.0, -0.5, -1.0 + 1e-12, -1.0])
def test_a_ray_has_two_unit_vectors_across_it(z: float) -> None:
    direction = np.array([0.6 * math.sqrt(1 - z * z), 0.8 * math.sqrt(1 - z * z), z])
    rays = with_fields(np.empty(1, dtype=RAY))
    with np.errstate(divide="ignore"):
        set_ray(np.zeros(3), direction, rays[0])
    across = np.array([[rays[name + axis][0] for axis in "xyz"] for name in ("e1", "e2", "d")])
    np.testing.assert_allclose(across @ across.T, np.eye(3), atol=1e-11)


def test_of_triangles_anywhere_the_nearest_is_found() -> None:
    rng = RNG(5)
    corner_m = rng.normal(size=(400, 1, 3)) * 10 + rng.normal(size=(400, 3, 3))
    triangles = Triangles(
        corner_m, rng.random(400) < 0.5, rng.random(400), rng.integers(0, 9, 400).astype(np.int16)
    )
    origin = 15 * rng.normal(size=(2000, 3))
    direction = units(rng.normal(size=(2000, 3)) * 8 - origin)
    mesh = TriangleMesh(triangles)
    found = mesh.cast(origin, direction)
    assert_same(found, cast_exact(mesh, origin, direction))
    assert 200 < np.isfinite(found.range_m).sum() < 1800
    assert found.inside.any()


def test_a_box_is_where_it_is() -> None:
    mesh = TriangleMesh(Triangles.alike(np.asarray(trimesh.creation.box((2.0, 4.0, 6.0)).triangles), 0.3))
    origin = RNG(7).uniform(-9, 9, (5000, 3))
    direction = units(RNG(8).normal(size=(5000, 3)))
    half = np.array([1.0, 2.0, 3.0])
    with np.errstate(divide="ignore"):
        near, far = np.sort([(-half - origin) / direction, (half - origin) / direction], axis=0)
    enter, leave = near.max(axis=1), far.min(axis=1)
    outside = (np.abs(origin) > half).any(axis=1)
    expected = np.where(outside & (enter <= leave) & (enter >= 0), enter, np.nan)
    found = mesh.cast(origin, direction)
    np.testing.assert_allclose(found.range_m, expected, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.inside, ~outside)
    met = np.isfinite(expected)
    side = near[met].argmax(axis=1)
    normal = -np.sign(direction[met, side])[:, None] * np.eye(3)[side]
    np.testing.assert_allclose(found.normal_site[met], normal, atol=1e-12)


def test_a_ray_that_starts_on_the_surface_hits_it_there() -> None:
    mesh = TriangleMesh(Triangles.alike(np.asarray(trimesh.creation.box((2.0, 2.0, 2.0)).triangles), 0.3))
    found = mesh.cast(np.tile([0.3, 0.2, 1.0], (2, 1)), np.array([[0, 0, -1.0], [0, 0, 1.0]]))
    np.testing.assert_array_equal(found.range_m, 0.0)
    assert not found.inside.any()


def test_a_sheet_is_seen_from_both_sides() -> None:
    corner_m = np.array([[[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]]])
    for sheet in (True, False):
        mesh = TriangleMesh(Triangles.alike(corner_m, 0.5, sheet))
        found = mesh.cast(np.array([[0, 0, 2.0], [0, 0, -2.0]]), np.array([[0, 0, -1.0], [0, 0, 1.0]]))
        np.testing.assert_array_equal(found.range_m, [2.0, 2.0 if sheet else np.nan])
        np.testing.assert_array_equal(found.normal_site[:, 2], [1.0, -1.0 if sheet else np.nan])
        np.testing.assert_array_equal(found.inside, [False, not sheet])


@pytest.mark.parametrize("away_m", [0.0, 1e5])
def test_no_ray_is_lost_at_edges_and_corners(away_m: float) -> None:
    # So level that no sensor sees an edge with one side hidden: there a ray may pass by.
    corner_m = hills(41, height_m=0.3) + np.array([away_m, -away_m, 0.0])
    inner = corner_m[(np.abs(corner_m[..., :2] - corner_m.mean(axis=(0, 1))[:2]) < 15).all(axis=(1, 2))]
    share = RNG(3).random((len(inner), 1))
    target = np.concatenate([inner[:, 0], inner[:, 0] * share + inner[:, 1] * (1 - share), inner[:, 1]])
    mesh = TriangleMesh(Triangles.alike(corner_m, 0.2))
    for height_m in (20.0, 2e4):
        sensor = corner_m.mean(axis=(0, 1)) + np.array([3.1, -4.7, height_m])
        aimed = units(target - sensor)
        down = np.broadcast_to([0.0, 0.0, -1.0], target.shape)
        for origin, direction in (
            (np.broadcast_to(sensor, target.shape), aimed),
            (target - height_m * down, down),
        ):
            found = mesh.cast(origin, direction)
            assert np.isfinite(found.range_m).all()
            assert (found.range_m <= np.linalg.norm(target - origin, axis=1) * (1 + 1e-9)).all()


def test_ten_kilometres_away_it_is_as_exact_as_a_formula() -> None:
    plane = PlaneGround(0.3, 1.0, 0.0)
    east, north = np.array([-9e3, 9e3, 0.0]), np.array([-9e3, -9e3, 1.2e4])
    corner_m = np.stack([east, north, plane.height_m(east, north)], axis=-1)[None]
    origin = np.tile([100.0, 20.0, 1e4], (200, 1))
    direction = units(RNG(4).normal(size=(200, 3)) * 0.1 - [0, 0, 1])
    found, exact = (
        TriangleMesh(Triangles.alike(corner_m, 1.0)).cast(origin, direction),
        cast_exact(plane, origin, direction),
    )
    np.testing.assert_allclose(found.range_m, exact.range_m, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.normal_site, exact.normal_site, atol=1e-12)


def test_the_bits_do_not_depend_on_the_company_of_other_rays() -> None:
    mesh = TriangleMesh(Triangles.alike(hills(30), 0.2))
    # Beams of beamlets, and rays on their own.
    beams = units(np.repeat(RNG(2).normal(size=(6, 3)) * 0.3 - [0, 0, 1], 64, axis=0))
    direction = units(np.concatenate([beams + 3e-4 * RNG(3).normal(size=beams.shape), beams[::-7]]))
    direction[17] = np.nan
    origin = np.tile([14.0, 15.0, 30.0], (len(direction), 1))
    whole = mesh.cast(origin, direction)
    assert np.isnan(whole.range_m[17])
    for size in (1, 7, 64):
        parts = [
            mesh.cast(origin[k : k + size], direction[k : k + size]) for k in range(0, len(origin), size)
        ]
        for name in ("range_m", "normal_site", "object_id", "inside", "reflectance"):
            np.testing.assert_array_equal(
                getattr(whole, name), np.concatenate([getattr(p, name) for p in parts])
            )
    assert_same(whole, cast_exact(mesh, origin, direction))


def test_triangles_all_at_one_place_are_still_a_tree() -> None:
    corner_m = np.tile(np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]]), (100, 1, 1))
    found = TriangleMesh(Triangles.alike(corner_m, 0.5)).cast(
        np.array([[0, 0, 3.0]]), np.array([[0, 0, -1.0]])
    )
    assert found.range_m[0] == 3.0


# Files


def write(mesh: object, path: Path) -> Path:
    mesh.export(path)  # type: ignore[attr-defined]
    return path


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl"])
def test_a_closed_mesh_is_reported_and_turned_outward(tmp_path: Path, suffix: str) -> None:
    box = trimesh.creation.box((2.0, 4.0, 6.0))
    box.invert()
    file = read_mesh(str(write(box, tmp_path / f"box.{suffix}")), "m")
    assert file.is_closed
    assert file.turned
    assert enclosed_m3(file.corner_m) == pytest.approx(48.0)
    assert file.description == (
        f"mesh box.{suffix}, 12 triangles, 2 x 4 x 6 m, closed, volume 48 m³, radii 3.742 to 3.742 m, "
        "faced inward: inverted"
    )


def test_an_open_mesh_and_one_at_odds_with_itself_are_reported(tmp_path: Path) -> None:
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    lidless = trimesh.Trimesh(box.vertices, box.faces[:-2], process=False)
    assert "open" in read_mesh(str(write(lidless, tmp_path / "open.obj")), "m").description
    faces = np.array(box.faces)
    faces[0] = faces[0, ::-1]
    odd = read_mesh(
        str(write(trimesh.Trimesh(box.vertices, faces, process=False), tmp_path / "odd.obj")), "m"
    )
    assert odd.is_closed
    assert not odd.faces_one_way
    assert "inconsistent" in odd.description


def test_triangles_without_area_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "flat.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nf 1 2 3\nf 1 2 4\n")
    file = read_mesh(str(path), "m")
    assert (len(file.corner_m), file.flat) == (1, 1)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("none.obj", None, "no such file"),
        ("empty.obj", "", "no triangles"),
        ("points.obj", "v 0 0 0\nv 1 0 0\n", "no triangles"),
        ("line.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no triangle has an area"),
        ("mesh.gltf", "{}", "no known format; use an OBJ, PLY or STL"),
        ("half.ply", "ply\nformat binary_little_endian 1.0\nelement vertex 9\nend_header\n", "no vertices"),
        ("short.stl", "x" * 90, "use an intact STL file"),
    ],
)
def test_a_file_that_is_no_mesh_is_refused_in_one_line(
    tmp_path: Path, name: str, text: str | None, words: str
) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError) as refusal:
        read_mesh(str(tmp_path / name), "m")
    assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)
    assert name in str(refusal.value)


# Places


def site(path: Path, unit: str = "m", radius_m: float = 90.0, **origin: object) -> Site:
    ground = MeshPart.model_validate(
        {"kind": "mesh", "file": str(path), "unit": unit, "origin": origin}, strict=False
    )
    return Site(ground=ground, body=Body(radius_m=radius_m))


@pytest.mark.slow
@pytest.mark.parametrize(("latitude_deg", "longitude_deg"), [(0, 0), (35, 120), (-80, 200), (90, 10)])
def test_the_origin_is_on_the_surface_with_up_away_from_the_centre(
    tmp_path: Path, latitude_deg: float, longitude_deg: float
) -> None:
    path = write(trimesh.creation.icosphere(4, 100.0), tmp_path / "ball.ply")
    scene = build_scene(site(path, latitude_deg=latitude_deg, longitude_deg=longitude_deg))
    down = np.array([[0, 0, -1.0]])
    assert scene.cast(np.array([[0, 0, 50.0]]), down).range_m[0] == pytest.approx(50.0, abs=1e-9)
    assert scene.height_m(np.zeros(1), np.zeros(1))[0] == pytest.approx(0.0, abs=1e-9)
    # Faces of a sphere divided four times lie up to 0.2 % inside of it.
    assert scene.origin_altitude_m == pytest.approx(10.0, abs=0.3)
    assert scene.cast(np.array([[0, 0, -20.0]]), down).inside[0]
    assert np.isnan(scene.height_m(np.array([101.0]), np.zeros(1))[0])
    assert scene.covers(np.array([500.0]), np.zeros(1))[0]


@pytest.mark.parametrize("order", ["1 2 3", "2 3 1", "3 1 2", "1 3 2", "3 2 1", "2 1 3"])
def test_the_origin_is_on_a_triangle_whichever_way_it_faces(tmp_path: Path, order: str) -> None:
    path = tmp_path / "patch.obj"
    path.write_text(f"v -5 -4 100\nv 7 1 100\nv -3 6 100\nf {order}\n")
    assert build_scene(site(path, latitude_deg=90, longitude_deg=0)).origin_altitude_m == pytest.approx(10.0)


def test_east_north_and_up_point_where_they_should(tmp_path: Path) -> None:
    # Three boxes along the axes of a small body.
    markers = [trimesh.creation.box((1, 1, 1)) for _ in range(3)]
    for axis, marker in enumerate(markers):
        marker.apply_translation(100.0 * np.eye(3)[axis])
    path = write(trimesh.util.concatenate(markers), tmp_path / "axes.ply")
    scene = build_scene(site(path, body_fixed_m=[100.0, 0.0, 0.0]))
    # On the equator at longitude 0: east is y, north is z; both boxes lie 100 m below.
    for way in ([100.0, 0, -100.0], [0, 100.0, -100.0]):
        start = np.array([[0, 0, 50.0]])
        found = scene.cast(start, units(np.array([way]) - start))
        assert found.object_id[0] == 0
    assert scene.origin_altitude_m == pytest.approx(10.0)


def test_a_place_without_a_surface_is_refused(tmp_path: Path) -> None:
    box = trimesh.creation.box((1, 1, 1))
    box.apply_translation([100, 0, 0])
    path = write(box, tmp_path / "box.obj")
    with pytest.raises(InputError, match="no surface at latitude 90, longitude 0; choose a place"):
        build_scene(site(path, latitude_deg=90, longitude_deg=0))


def test_a_mesh_in_the_wrong_unit_is_refused(tmp_path: Path) -> None:
    path = write(trimesh.creation.icosphere(3, 0.1), tmp_path / "km.ply")
    with pytest.raises(
        InputError,
        match=r"site.body.radius_m: 90 m for a mesh whose surface is .*; correct it, or ground.unit",
    ):
        build_scene(site(path, "m", latitude_deg=10.0, longitude_deg=20.0))
    build_scene(site(path, "km", latitude_deg=10.0, longitude_deg=20.0))


def test_an_open_mesh_that_faces_down_is_still_ground(tmp_path: Path) -> None:
    corner_m = hills(9)[:, ::-1]
    path = write(trimesh.Trimesh(**trimesh.triangles.to_kwargs(corner_m)), tmp_path / "patch.obj")
    file = read_mesh(str(path), "m")
    scene = place_mesh(file, MeshPart(kind="mesh", file="", unit="m"), Site(ground=Sphere(kind="sphere")))
    found = scene.cast(np.array([[4.0, 4.0, 9.0], [4.0, 4.0, -9.0]]), np.array([[0, 0, -1.0], [0, 0, 1.0]]))
    assert found.range_m[0] < 9
    assert found.normal_site[0, 2] > 0
    assert found.inside[1]
    np.testing.assert_array_equal(scene.covers(np.array([4.0, 40.0]), np.array([4.0, 4.0])), [True, False])


def test_a_small_body_is_flown_over(public_data: Path, tmp_path: Path) -> None:
    from lidar_emu import load, simulate

    file = public_data / ITOKAWA
    ground = f"{{kind: mesh, file: {file}, unit: km, origin: {{latitude_deg: 20, longitude_deg: 30}}}}"
    ways = "[{altitude_m: 300, speed_mps: 20}, {altitude_m: 20, speed_mps: 5}]"
    (tmp_path / "itokawa.yaml").write_text(
        "name: itokawa\ninstrument: ndl_fine\nscanner: ndl_four_beam\n"
        f"site: {{body: {{name: Itokawa, radius_m: 162}}, ground: {ground}}}\n"
        f"trajectory: {{kind: profile, waypoints: {ways}}}\n"
    )
    run = simulate(load(tmp_path / "itokawa.yaml", {"timing.rate_hz": "5"}))
    assert run.range_valid.mean() > 0.9
    assert np.nanmedian(np.abs(run.range_m - run.true_range_m)) < 0.05
    assert np.isfinite(run.true_range_m).all()
