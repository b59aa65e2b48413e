"""`lidar-emu ground --compare embreex`: no false alarms on sound meshes, and every planted fault of ours is found."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from lidar_emu.cli import cli
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.casting_comparison import RAYS, compare_casting
from lidar_emu.scene.mesh.ground import TriangleMesh, Triangles
from lidar_emu.scene.objects.build import ellipsoid

pytest.importorskip("embreex")
BALL_M = ellipsoid(2.0, 1.0, 0.0)


def compared(corner_m: FloatArray, sheet: bool = False) -> dict[str, Any]:
    return compare_casting(TriangleMesh(Triangles.alike(corner_m, 0.3, sheet)), np.random.default_rng(1))


@pytest.mark.parametrize(
    ("corner_m", "sheet"),
    [
        (BALL_M, False),
        (BALL_M + 1e6, False),
        (BALL_M * 1e8, False),
        (BALL_M * 1e-9, False),
        (BALL_M[30:], True),
        (np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1e-7, 0.0]]]), True),
    ],
    ids=["ball", "far away", "huge", "tiny", "with a hole", "thinner than float32"],
)
def test_sound_meshes_pass(corner_m: FloatArray, sheet: bool) -> None:
    found = compared(corner_m, sheet)
    assert found["unexplained"] == 0
    assert found["apart_m"]["median"] < found["tolerance_m"]
    assert found["hit_by_both"] > 0.4 * RAYS


Cast = Callable[[FloatArray, FloatArray], FloatArray]


def longer(cast: Cast, origin_m: FloatArray, direction: FloatArray) -> FloatArray:
    """Within a twentieth of the ball."""
    range_m = cast(origin_m, direction)
    return np.where(origin_m[:, 2] + range_m * direction[:, 2] > 0.45, range_m * (1 + 1e-5), range_m)


def lost_at_edges(cast: Cast, origin_m: FloatArray, direction: FloatArray) -> FloatArray:
    """Of the rays that are aimed there; not of those beside."""
    range_m = cast(origin_m, direction)
    if len(range_m) == RAYS:
        range_m[: RAYS // 5 : 100] = np.nan
    return range_m


@pytest.mark.parametrize("fault", [longer, lost_at_edges])
def test_faults_of_ours_are_found(fault: Callable[..., FloatArray], monkeypatch: pytest.MonkeyPatch) -> None:
    cast = TriangleMesh.cast
    monkeypatch.setattr(
        TriangleMesh,
        "cast",
        lambda mesh, origin_m, direction: cast(mesh, origin_m, direction)._replace(
            range_m=fault(lambda o, d: cast(mesh, o, d).range_m, origin_m, direction)
        ),
    )
    found = compared(BALL_M)
    assert found["unexplained"] > 10
    assert found["worst"][0]["unexplained"]


def ground(*words: str) -> Result:
    return CliRunner().invoke(cli, ["ground", *words])


def test_of_a_scenario_and_of_a_file(tmp_path: Path) -> None:
    of_objects = ground("hazards", "--compare", "embreex", "--json")
    assert of_objects.exit_code == 0, of_objects.output
    assert json.loads(of_objects.output)["objects"]["triangles"] == 20
    mesh = tmp_path / "one.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    of_file = ground(str(mesh), "--compare", "embreex")
    assert of_file.exit_code == 0, of_file.output
    assert "triangles: 1\n" in of_file.output
    assert "unexplained: 0\n" in of_file.output


def test_refusals_are_one_line() -> None:
    for words, line in (
        (("descent", "--compare", "embreex"), "descent: site: no triangles; name a site with a mesh"),
        (("hazards", "--compare", "open3d"), "--compare: must be embreex (got 'open3d')"),
        (("hazards", "--compare", "embreex", "--out", "a.npz"), "--compare: writes no file; leave out"),
    ):
        assert str(ground(*words).exception).startswith(line)
