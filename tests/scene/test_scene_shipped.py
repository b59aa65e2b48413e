"""The sites and the ground that come with the package."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from lidar_emu.scenario.parts import shipped
from lidar_emu.scenario.site import Site
from lidar_emu.scene import build_scene

GENERATOR = Path(__file__).resolve().parents[2] / "tools" / "make_ground.py"
MARE = shipped("ground") / "mare.npz"


def shipped_site(name):
    tree = YAML(typ="safe", pure=True).load((shipped("sites") / name).read_text())
    if "file" in tree["ground"]:
        tree["ground"]["file"] = str(shipped("ground") / tree["ground"]["file"])
    return Site.model_validate_json(json.dumps(tree))


@pytest.fixture(scope="module")
def generator():
    spec = importlib.util.spec_from_file_location("make_ground", GENERATOR)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_generator_makes_the_committed_ground(generator):
    with np.load(MARE) as file:
        np.testing.assert_array_equal(file["elevation_m"], generator.mare())
        assert (file["pixel_m"], file["map_x_m"], file["map_y_m"]) == (4.0, -1024.0, 1024.0)
    assert MARE.stat().st_size < 700_000


def test_plane_continues_the_mare_without_a_step():
    ground = build_scene(shipped_site("mare.yaml"))
    height = ground.samples.height_m
    for rim in (height[0], height[-1], height[:, 0], height[:, -1]):
        np.testing.assert_array_equal(rim, 0.0)
    edge = np.linspace(-1024, 1024, 401)
    origin = np.stack(
        [np.concatenate([edge, np.full(401, 1024.0)]), np.concatenate([np.full(401, -1024.0), edge])], 1
    )
    origin = np.column_stack([origin + np.array([3.0, 4.0]), np.full(802, 50.0)])
    hits = ground.cast(origin, np.tile(np.array([-3.0, -4.0, -50.0]) / 2525**0.5, (802, 1)))
    np.testing.assert_allclose(hits.range_m, 2525**0.5, rtol=1e-12)
    assert (hits.normal_site[:, 2] > 0.9).all()


@pytest.mark.parametrize("name", ["flat.yaml", "mars.yaml", "mare.yaml", "sphere.yaml"])
def test_every_site_has_its_ground_at_the_origin(name):
    part = shipped_site(name)
    ground = build_scene(part)
    assert ground.height_m(np.zeros(1), np.zeros(1))[0] == 0
    hits = ground.cast(np.array([[0.0, 0.0, 100.0]]), np.array([[0.0, 0.0, -1.0]]))
    assert hits.range_m[0] == pytest.approx(100, rel=1e-14)
    assert part.name == Path(name).stem
    assert part.surface.reflectance == (0.25 if name == "mars.yaml" else 0.18)
