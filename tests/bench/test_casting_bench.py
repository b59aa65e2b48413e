"""The comparison of casters: its exact ranges, its ground as triangles, and its report without peers."""

from dataclasses import replace
from fractions import Fraction
from unittest.mock import Mock

import numpy as np
import pytest

from benchmarks import casting, casting_peers
from benchmarks.casting_exact import exact_range_m, lunar_site
from benchmarks.casting_scene import KINDS, rolling_ground, triangles, unrelated
from lidar_emu.scene.grid.cell import Samples


def test_exact_ranges_are_those_known_by_hand():
    """A peak of 2 m: at it, on the diagonal that rises to it, and below that on the triangle beside."""
    height_m = np.zeros((6, 6))
    height_m[2, 2] = 2.0
    samples = Samples(height_m, 0, 0, 1, 1, "triangles")
    down = [Fraction(0), Fraction(0), Fraction(-1)]
    half, third = Fraction(1, 2), Fraction(1, 3)
    for east, north, height in ((2, 2, 2), (1 + half, 1 + half, 1), (1 + 2 * third, 1 + third, 2 * third)):
        origin = [Fraction(east), Fraction(north), Fraction(9)]
        assert exact_range_m(samples, origin, down, 5.0) == 9 - height
    assert exact_range_m(samples, [Fraction(1), Fraction(1), Fraction(-1)], down, 0.0) is None


def test_less_than_a_nanometre_from_fractions_in_body_axes_and_at_ten_kilometres():
    ground, frame = rolling_ground(300, "triangles"), lunar_site(0.44, -0.82, 1_737_400.0)
    for altitude_m in (2000.0, 10_000.0):
        rays = unrelated(np.random.default_rng(2), 12, altitude_m)
        origin, direction = frame.to_fixed(rays.origin_m), frame.to_fixed(rays.direction, False)
        found = ground.cast(frame.to_site(origin), frame.to_site(direction, False)).range_m
        for k in range(12):
            ray = frame.exactly_to_site(origin[k]), frame.exactly_to_site(direction[k], False)
            exact = exact_range_m(ground.samples, *ray, float(found[k]))
            assert abs(Fraction(float(found[k])) - exact) < Fraction(1, 10**9)


def test_triangles_are_the_surface():
    """Their planes at their own centres, all facing up."""
    ground = rolling_ground(20, "triangles")
    vertex_m, face = triangles(ground.samples)
    corners = vertex_m[face]
    assert len(face) == 800
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0).all()
    centre = corners.mean(axis=1)
    np.testing.assert_allclose(ground.height_m(centre[:, 0], centre[:, 1]), centre[:, 2], rtol=0, atol=1e-12)


@pytest.fixture
def small(monkeypatch):
    """A comparison that takes a second, on whatever core, without peers."""
    for name, value in {
        "_CELLS": 300,
        "_MANY_CELLS": 60,
        "_SHOTS": 2,
        "_ROUNDS": 2,
        "_AIMED": 2000,
        "_CHUNK": 1000,
        "_EXACT_RAYS": 3,
    }.items():
        monkeypatch.setattr(casting, name, value)
    monkeypatch.delattr("os.sched_setaffinity", raising=False)
    monkeypatch.setattr(casting_peers, "find_spec", lambda _: None)


@pytest.mark.usefixtures("small")
def test_the_report_has_all_rays_and_places(capsys: pytest.CaptureFixture[str]) -> None:
    report = casting.measure_casting()
    assert report.absent == {"embreex": "not installed", "open3d": "not installed"}
    assert report.lost == {"lidar-emu": 0}
    assert set(report.time_s) == set(KINDS)
    for place in ("2 km", "10 km", "2 km, Moon-fixed"):
        assert 0 < report.error_m[place]["lidar-emu"][1] < 1e-9
    casting.print_report(report)
    shown = capsys.readouterr().out
    assert "embreex: left out, not installed (pip install '.[peers]')" in shown
    assert "| 256 unrelated |" in shown
    assert "ratio:" not in shown


@pytest.mark.usefixtures("small")
def test_the_ratio_is_to_embreex_called_for_each_shot(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    embreex = Mock(range_m=lambda origin, _: np.zeros(len(origin)))
    monkeypatch.setattr(casting, "installed_peers", lambda: ({"embreex": lambda *_: embreex}, {}))
    time_s = {"lidar-emu": 2e-6, "embreex": 30e-6, "embreex, one call": 26e-6}
    report = casting.measure_casting()
    assert time_s.keys() < report.time_s["4 axes"].keys()
    report = replace(report, time_s=dict.fromkeys(KINDS, time_s))
    casting.print_report(report)
    what = "time of embreex to ours, 4 beams of 61 on triangles; 13 with 2 shots in one call of embreex"
    assert capsys.readouterr().out.endswith(f"\nratio: 15 ({what})\n")
