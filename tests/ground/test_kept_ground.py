"""Generated ground is made once, whatever else goes on, and is flown as a grid."""

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from parts_of_ground import CRATERS, MARS_ROCKS, MOON_ROCKS, RELIEF
from pydantic import ValidationError

from lidar_emu.errors import InputError
from lidar_emu.scenario.site import Site
from lidar_emu.scene import build_scene
from lidar_emu.scene.procedural import generate as generator
from lidar_emu.scene.procedural.generate import cache_path, elevation_m

ALL = {"relief": RELIEF, "craters": CRATERS, "rocks": MOON_ROCKS}


def refuse(_ground):
    raise AssertionError("it was made again")


def test_it_is_made_once(ground, cache, monkeypatch):
    asked = ground(**ALL)
    made = elevation_m(asked)
    assert [path.name for path in cache.iterdir()] == [cache_path(asked).name]
    monkeypatch.setattr(generator, "generate", refuse)
    np.testing.assert_array_equal(elevation_m(asked), made)
    np.testing.assert_array_equal(elevation_m(ground(**ALL, beyond="plane")), made)
    with pytest.raises(AssertionError, match="made again"):
        elevation_m(ground(**ALL, seed=2))


@pytest.mark.parametrize("damage", [b"", b"no array", "half"])
def test_a_damaged_file_is_made_anew(ground, damage):
    asked = ground(**ALL)
    made = elevation_m(asked)
    path = cache_path(asked)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] if damage == "half" else damage)
    np.testing.assert_array_equal(elevation_m(asked), made)
    assert path.read_bytes() == whole


def test_a_header_that_numpy_cannot_parse_is_damage(ground, tmp_path):
    asked = ground(**ALL)
    made = elevation_m(asked)
    path = cache_path(asked)
    damaged = path.read_bytes().replace(b"}", b"{", 1)
    path.write_bytes(damaged)
    np.testing.assert_array_equal(elevation_m(asked), made)
    given = tmp_path / "ground.npz"
    np.savez(given, elevation_m=np.zeros((8, 8)), pixel_m=1.0)
    given.write_bytes(given.read_bytes().replace(b"}", b"{", 1))
    site = Site.model_validate({"name": "mine", "ground": {"kind": "grid", "file": str(given)}})
    with pytest.raises(InputError, match=r"ground\.npz: unreadable"):
        build_scene(site)


@pytest.fixture
def kept(ground):
    asked = ground(relief=RELIEF)
    made = elevation_m(asked)
    return asked, made, cache_path(asked).read_bytes()


@pytest.mark.slow
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(at=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7), page=st.booleans())
def test_damaged_bytes_move_no_height(kept, at, bit, page):
    asked, made, whole = kept
    damaged, first = bytearray(whole), int(at * len(whole))
    damaged[first] ^= 1 << bit
    if page:
        damaged[first : first + 4096] = bytes(len(damaged[first : first + 4096]))
    cache_path(asked).write_bytes(damaged)
    np.testing.assert_array_equal(elevation_m(asked), made)


def test_without_a_cache_it_is_made_each_time(ground, monkeypatch, tmp_path):
    asked = ground(**ALL)
    made = elevation_m(asked)
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    np.testing.assert_array_equal(elevation_m(asked), made)


@pytest.mark.slow
def test_processes_may_ask_at_once(ground, cache):
    asked = ground(**ALL)
    code = (
        "import hashlib, sys\n"
        "from lidar_emu.scene.procedural.generate import elevation_m\n"
        "from lidar_emu.scenario.ground import Generated\n"
        "made = elevation_m(Generated.model_validate_json(sys.argv[1]))\n"
        "print(hashlib.sha256(made.tobytes()).hexdigest())"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", code, asked.model_dump_json()]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) for _ in range(3)]
    digests = {process.communicate()[0].strip() for process in both}
    assert [process.returncode for process in both] == [0, 0, 0]
    assert digests == {hashlib.sha256(elevation_m(asked).tobytes()).hexdigest()}
    assert [path.name for path in cache.iterdir()] == [cache_path(asked).name]


def test_parts_do_not_change_one_another(ground):
    whole = generator.generate(ground(**ALL))
    relief = generator.generate(ground(relief=RELIEF))
    without = generator.generate(ground(relief=RELIEF, rocks=MOON_ROCKS))
    np.testing.assert_array_equal(relief.relief_m, whole.relief_m)
    np.testing.assert_array_equal(without.rock_m, whole.rock_m)
    assert relief.crater_m is relief.rock_m is without.crater_m is None
    total = whole.relief_m + whole.crater_m + whole.rock_m
    np.testing.assert_allclose(whole.elevation_m(ground(**ALL)), total, atol=1e-5)


def test_it_is_flown_as_a_grid(ground):
    """Rays straight down on samples meet the elevations of the file, counted from the ground at the centre."""
    asked = ground(**ALL, beyond="plane")
    scene = build_scene(Site(ground=asked))
    height = elevation_m(asked).astype(np.float64)
    row, column = np.array([0, 128, 200, 256]), np.array([256, 128, 3, 0])
    origin = np.stack([column - 128.0, 128.0 - row, np.full(4, 500.0)], axis=1)
    hits = scene.cast(origin, np.tile([0.0, 0.0, -1.0], (4, 1)))
    np.testing.assert_allclose(500 - hits.range_m, height[row, column] - height[128, 128], atol=1e-9)
    size = "257 x 257 samples at 1 m, 256 m x 256 m"
    heights = f"heights {height.min():.2f} to {height.max():.2f} m"
    assert scene.description.startswith(f"grid generated (seed 1), {size}, {heights}, largest step ")
    assert scene.description.endswith(" m; beyond: plane")
    assert scene.height_m(np.array([900.0]), np.array([0.0]))[0] == 0
    beyond_none = build_scene(Site(ground=ground(**ALL)))
    assert np.isnan(beyond_none.height_m(np.array([900.0]), np.array([0.0]))[0])


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"spacing_m": 3.0}, "whole spacings"),
        ({"spacing_m": 16.0}, "32 to 4096"),
        ({"spacing_m": 0.01}, "32 to 4096"),
        ({"relief": RELIEF | {"baseline_m": 0.5}}, "relief.baseline_m"),
        ({"relief": RELIEF | {"baseline_m": 65.0}}, "relief.baseline_m"),
        ({"relief": RELIEF | {"hurst": 1.0}}, "hurst"),
        ({"craters": CRATERS | {"smallest_diameter_m": 3.0}}, "craters.smallest_diameter_m"),
        ({"craters": CRATERS | {"largest_diameter_m": 3.0}}, "craters.largest_diameter_m"),
        ({"craters": CRATERS | {"largest_diameter_m": 129.0}}, "craters.largest_diameter_m"),
        ({"rocks": MARS_ROCKS | {"smallest_diameter_m": 12.0}}, "rocks.smallest_diameter_m"),
        ({"rocks": {"kind": "pebbles"}}, "pebbles"),
    ],
)
def test_what_the_grid_cannot_show_is_refused(ground, keys, expected):
    with pytest.raises(ValidationError, match=expected):
        ground(**keys)
