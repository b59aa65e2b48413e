"""Objects: their shapes, where they stand, and how those that move are met."""

import math

import numpy as np
import pytest
from exact_casting import cast_exact
from pydantic import TypeAdapter, ValidationError

from lidar_emu.errors import InputError
from lidar_emu.scenario.objects import PlacedObject
from lidar_emu.scenario.site import Body, Plane, Site, Sphere, Surface
from lidar_emu.scene import build_scene
from lidar_emu.scene.mesh.file import enclosed_m3
from lidar_emu.scene.objects.build import corners_m
from lidar_emu.scene.ray_hits import MovingScene, Scene

trimesh = pytest.importorskip("trimesh")

DOWN = np.array([0.0, 0.0, -1.0])
PARTS: TypeAdapter[PlacedObject] = TypeAdapter(PlacedObject)


def part(**keys: object) -> PlacedObject:
    return PARTS.validate_python({"name": "it", **keys}, strict=False)


def scene(*objects: PlacedObject, ground: object = None) -> Scene:
    return build_scene(
        Site(ground=ground or Plane(kind="plane"), objects=list(objects), surface=Surface(reflectance=0.2))
    )


def look_down(on: Scene, places: list[tuple[float, float]], from_m: float = 100.0) -> object:
    origin = np.array([[east, north, from_m] for east, north in places])
    return on.cast(origin, np.broadcast_to(DOWN, origin.shape))


SHAPES = {
    "slab": ({"kind": "slab", "length_m": 4, "width_m": 2, "height_m": 1}, 8.0),
    "ramp": ({"kind": "ramp", "length_m": 4, "width_m": 2, "height_m": 1}, 4.0),
    "cliff": ({"kind": "cliff", "length_m": 4, "width_m": 2, "height_m": 1}, 8.0),
    "sloping cliff": ({"kind": "cliff", "length_m": 4, "width_m": 2, "height_m": 1, "face_deg": 45}, 9.0),
    "pad": (
        {"kind": "pad", "diameter_m": 4, "height_m": 0.5},
        2.0 * 24 * math.sin(math.radians(7.5)) * 0.5 * 2,
    ),
}


@pytest.mark.parametrize("name", SHAPES)
def test_shapes_are_closed_and_of_the_volume_that_is_asked_for(name: str) -> None:
    keys, volume_m3 = SHAPES[name]
    corner_m = corners_m(part(**keys))
    whole = trimesh.Trimesh(**trimesh.triangles.to_kwargs(corner_m))
    whole.merge_vertices()
    assert whole.is_watertight
    assert whole.is_winding_consistent
    assert enclosed_m3(corner_m) == pytest.approx(volume_m3)
    assert corner_m[..., 2].min() == 0.0


def test_round_shapes_come_close_to_their_formulas() -> None:
    boulder = corners_m(part(kind="boulder", diameter_m=2, height_m=0.6))
    assert enclosed_m3(boulder) == pytest.approx(4 / 3 * math.pi * 1 * 1 * 0.6, rel=0.05)
    np.testing.assert_allclose((boulder**2 @ [1, 1, 1 / 0.36]), 1.0, atol=1e-12)
    tree = corners_m(part(kind="tree", height_m=9, crown_diameter_m=4))
    crown, trunk = 4 / 3 * math.pi * 2 * 2 * 3, math.pi * 0.04 * 6
    assert enclosed_m3(tree) == pytest.approx(crown + trunk, rel=0.06)
    assert (tree[..., 2].min(), tree[..., 2].max()) == pytest.approx((0, 9), abs=0.2)


def test_forward_is_north_at_first_and_east_after_a_quarter_turn() -> None:
    ramp = {"kind": "ramp", "length_m": 10, "width_m": 2, "height_m": 5}
    places = [(0.0, 8.0), (8.0, 0.0), (0.0, -8.0)]
    np.testing.assert_allclose(look_down(scene(part(**ramp)), places).range_m, [96, 100, 100])
    np.testing.assert_allclose(look_down(scene(part(**ramp, yaw_deg=90)), places).range_m, [100, 96, 100])
    # Pitched up by the ramp's own angle from the other side, the top lies level at its far end.
    level = part(**ramp, pitch_deg=-math.degrees(math.atan2(5, 10)))
    np.testing.assert_allclose(look_down(scene(level), places[:1]).normal_site[0], [0, 0, 1], atol=1e-12)


def test_objects_stand_on_the_ground_and_keep_what_is_their_own() -> None:
    slope = Plane(kind="plane", slope_deg=20, downhill_azimuth_deg=90)
    objects = [
        part(name="a", kind="pad", east_m=-30, diameter_m=4, reflectance=0.7),
        part(name="b", kind="boulder", east_m=30, diameter_m=2),
        part(name="c", kind="slab", up_m=50, length_m=2, width_m=2, height_m=1, reflectance=0.0),
    ]
    found = look_down(scene(*objects, ground=slope), [(-30, 0), (30, 0), (0, 0), (60, 0)])
    rise_m = math.tan(math.radians(20)) * 30
    np.testing.assert_allclose(
        found.range_m, [100 - rise_m - 0.1, 100 + rise_m - 1, 49, 100 + 2 * rise_m], atol=0.02
    )
    np.testing.assert_array_equal(found.object_id, [1, 2, 3, 0])
    np.testing.assert_array_equal(found.reflectance, [0.7, 0.2, 0.0, 0.2])


@pytest.mark.slow
def test_of_ground_and_objects_the_first_is_hit_and_none_from_within() -> None:
    rng = np.random.default_rng(3)
    rocks = part(kind="boulder", diameter_m=4, scatter={"count": 12, "radius_m": 15, "scale": [0.5, 2]})
    trees = part(name="t", kind="tree", height_m=9, crown_diameter_m=5, scatter={"count": 6, "radius_m": 15})
    both = scene(rocks, trees)
    origin = np.column_stack([rng.uniform(-15, 15, (500, 2)), rng.uniform(0.01, 20, 500)])
    direction = rng.normal(size=(500, 3)) - [0, 0, 0.7]
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    fast, exact = both.cast(origin, direction), cast_exact(both, origin, direction)
    np.testing.assert_allclose(fast.range_m, exact.range_m, rtol=0, atol=1e-10)
    for name in ("inside", "object_id", "reflectance"):
        np.testing.assert_array_equal(getattr(fast, name), getattr(exact, name))
    assert {0, 1, 2, -1} == set(fast.object_id.tolist())
    assert 5 < fast.inside.sum() < 250
    height_m = both.height_m(origin[:, 0], origin[:, 1])
    above = both.cast(origin + np.array([0, 0, 100.0]), np.broadcast_to(DOWN, origin.shape)).range_m
    np.testing.assert_allclose(origin[:, 2] + 100 - above, height_m, atol=1e-9)


def test_scattered_copies_cover_what_their_number_and_sizes_say() -> None:
    keys = {"kind": "pad", "diameter_m": 2, "height_m": 0.5}
    rng = np.random.default_rng(1)
    places = rng.uniform(-100, 100, (40_000, 2))
    places = places[np.hypot(*places.T) < 98]

    def top_m(**scatter: object) -> np.ndarray:
        on = scene(part(**keys, scatter={"count": 500, "radius_m": 100, **scatter}))
        return on.height_m(places[:, 0], places[:, 1])

    alike = top_m()
    # Discs at random leave exp(-share) of the ground bare.
    share = 500 * 24 * math.sin(math.radians(7.5)) * 2 / 2 / (math.pi * 100**2)
    assert (alike > 0).mean() == pytest.approx(1 - math.exp(-share), rel=0.08)
    assert set(np.round(np.unique(alike), 9)) == {0.0, 0.5}
    inner = np.hypot(*places.T) < 70
    assert (alike[inner] > 0).mean() == pytest.approx((alike > 0).mean(), rel=0.2)
    varied = top_m(scale=[0.5, 4.0])
    assert 0.25 <= varied[varied > 0].min() < 0.3
    assert 1.8 < varied.max() <= 2.0
    np.testing.assert_array_equal(top_m(), alike)
    assert (top_m(seed=2) != alike).any()


def test_a_wall_that_comes_nearer_is_met_where_it_is() -> None:
    wall = part(
        kind="slab",
        east_m=50,
        length_m=20,
        width_m=1,
        height_m=20,
        up_m=-10,
        motion={"velocity_mps": [-3.0, 1.0, 0]},
    )
    on = scene(wall)
    assert isinstance(on, MovingScene)
    time_s = np.array([0.0, 2.0, 10.0])
    origin = np.tile([0.0, 0.0, 5.0], (6, 1))
    direction = np.tile([[1.0, 0, 0], [0, 0, -1.0]], (3, 1))
    found = on.cast_at((1e9 * time_s).astype(np.int64), origin, direction)
    np.testing.assert_allclose(found.range_m[::2], 49.5 - 3 * time_s, atol=1e-12)
    np.testing.assert_array_equal(found.range_m[1::2], 5.0)
    np.testing.assert_array_equal(found.velocity_site_mps[::2], np.tile([-3.0, 1.0, 0], (3, 1)))
    np.testing.assert_array_equal(found.velocity_site_mps[1::2], 0.0)
    np.testing.assert_array_equal(found.object_id, [1, 0, 1, 0, 1, 0])
    # By 11 s it has passed to the north of the beam.
    late = on.cast_at(np.array([int(11e9)]), origin[:1], direction[:1])
    assert np.isnan([late.range_m[0], *late.velocity_site_mps[0]]).all()
    at_start, exact = on.cast(origin, direction), cast_exact(on, origin, direction)
    np.testing.assert_allclose(at_start.range_m, exact.range_m, atol=1e-12)
    np.testing.assert_array_equal(at_start.velocity_site_mps, exact.velocity_site_mps)


def test_waypoints_are_flown_straight_and_rest_at_both_ends() -> None:
    ways = [
        {"time_s": 2, "east_m": 0, "north_m": 0, "up_m": 10},
        {"time_s": 4, "east_m": 6, "north_m": -2, "up_m": 14},
        {"time_s": 5, "east_m": 6, "north_m": -2, "up_m": 10},
    ]
    on = scene(part(kind="pad", diameter_m=3, height_m=0.5, motion={"waypoints": ways}))
    for time_s, place, velocity in [
        (0.0, (0, 0, 10), (0, 0, 0)),
        (3.0, (3, -1, 12), (3, -1, 2)),
        (4.5, (6, -2, 12), (0, 0, -4)),
        (9.0, (6, -2, 10), (0, 0, 0)),
    ]:
        origin = np.array([[place[0] + 1.0, place[1] + 0.5, 60.0]])
        found = on.cast_at(np.array([round(1e9 * time_s)]), origin, DOWN[None])
        assert found.range_m[0] == pytest.approx(60 - place[2] - 0.5, abs=1e-12)
        np.testing.assert_allclose(found.velocity_site_mps[0], velocity, atol=1e-12)


def test_where_there_is_no_ground_nothing_can_stand() -> None:
    far = part(name="far rock", kind="boulder", diameter_m=1, north_m=200.0)
    small = Site(ground=Sphere(kind="sphere"), body=Body(radius_m=100.0), objects=[far])
    with pytest.raises(
        InputError, match=r"site.objects.0: no ground at 0.0 m east, 200.0 m north.*'far rock'.*up_m"
    ):
        build_scene(small)
    aloft = part(kind="boulder", diameter_m=1, north_m=200.0, up_m=3.0)
    assert look_down(build_scene(small.model_copy(update={"objects": [aloft]})), [(0, 200)]).object_id[0] == 1


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"kind": "boulder", "diameter_m": 0}, "greater than 0"),
        ({"kind": "boulder", "diameter_m": float("nan")}, "finite"),
        ({"kind": "pad", "diameter_m": 1, "scatter": {"count": 3, "radius_m": 1, "scale": [2, 1]}}, "smallest size"),
        ({"kind": "pad", "diameter_m": 1, "scatter": {"count": 10**6, "radius_m": 1}}, "100000"),
        ({"kind": "pad", "diameter_m": 1, "up_m": 1, "scatter": {"count": 3, "radius_m": 1}}, "stand on the ground"),
        ({"kind": "pad", "diameter_m": 1, "motion": {"velocity_mps": [0, 0, 1], "waypoints": [
            {"time_s": 0, "east_m": 0, "north_m": 0, "up_m": 0}]}}, "not both"),
        ({"kind": "pad", "diameter_m": 1, "motion": {"waypoints": 2 * [
            {"time_s": 1, "east_m": 0, "north_m": 0, "up_m": 0}]}}, "later than the one before"),
        ({"kind": "cliff", "length_m": 1, "width_m": 1, "height_m": 1, "face_deg": 95}, "90"),
        ({"kind": "rock", "diameter_m": 1}, "boulder"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused(keys: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        part(**keys)


def test_names_are_given_once() -> None:
    pad = part(kind="pad", diameter_m=1)
    with pytest.raises(ValidationError, match="a name that no other object has"):
        Site(ground=Plane(kind="plane"), objects=[pad, pad])


def test_more_triangles_than_fit_into_memory_are_refused_before_they_are_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("lidar_emu.scene.objects.build.MAXIMUM_TRIANGLES", 3 * 320 - 1)
    with pytest.raises(
        InputError,
        match=r"site.objects: 960 triangles within reach of the beams, more than 959; scatter fewer",
    ):
        scene(part(kind="boulder", diameter_m=1, scatter={"count": 3, "radius_m": 5}))
