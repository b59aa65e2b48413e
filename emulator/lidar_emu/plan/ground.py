"""Plan of the ground: how it is cast on, its parts and objects, and what no beam reaches."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lidar_emu.beams.flight import Flight
from lidar_emu.beams.pointing import Pointing
from lidar_emu.numerics.vector_arrays import dot
from lidar_emu.plan import Decision
from lidar_emu.plan.beat_errors import BeatErrors
from lidar_emu.plan.motion import largest
from lidar_emu.receiver.echoes import LEAST_COSINE
from lidar_emu.scenario.ground import Generated, Mesh
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scenario.site import ElevationGrid, Nested
from lidar_emu.scene.mosaic.grids import PaintedGround
from lidar_emu.scene.mosaic.nested import NestedGround
from lidar_emu.scene.ray_hits import Hits, Scene
from lidar_emu.scene.ray_reach import CroppedGrid, CroppedGround
from lidar_emu.scene.terrain.read import lies_flat


def plan_ground(
    scenario: FlightScenario, flight: Flight, pointing: Pointing, hits: Hits, errors: BeatErrors
) -> list[Decision]:
    ground = scenario.site.ground
    if isinstance(ground, Mesh):
        return [Decision("ground", True, flight.scene.description, "the site has a mesh", "exact")]
    if not isinstance(ground, ElevationGrid | Generated | Nested):
        return [
            Decision("ground", True, flight.scene.description, f"a {ground.kind} has a closed form", "exact"),
            Decision("grid traversal", False, "-", "the site has no elevation grid", "exact"),
        ]
    grid = Decision("ground", True, flight.scene.description, "the site has an elevation grid", "exact")
    parts = list(_parts(flight.ground))
    grids = ground.grids if isinstance(ground, Nested) else [ground]
    if not any(isinstance(grid, Generated) or lies_flat(grid) for grid in grids):
        on_body = "by the map's projection"
        return [grid, Decision("curvature of the grid", True, on_body, "the file states it", "exact"), *parts]
    return [grid, _map_plane(scenario.site.body.radius_m, pointing, hits, errors), *parts]


def _map_plane(radius_m: float, pointing: Pointing, hits: Hits, errors: BeatErrors) -> Decision:
    """State what a grid without projection lacks: the body curves away below it, and tilts the ground."""
    horizontal_m = (pointing.sensor_site_m + hits.range_m[..., None] * pointing.true_site)[..., :2]
    away_m = np.sqrt((horizontal_m**2).sum(axis=-1))
    fall_m = away_m**2 / (2 * radius_m)
    cosine = np.maximum(-dot(hits.normal_site, pointing.true_site), LEAST_COSINE)
    farther_m = fall_m * np.abs(hits.normal_site[..., 2]) / cosine
    dimmer = 2 * farther_m / hits.range_m + away_m / radius_m / cosine
    effect = errors.bias(0.0, largest(dimmer))._replace(range_m=largest(farther_m))
    bound = f"{largest(fall_m):.2g} m of height, {largest(away_m):.0f} m from the origin"
    return Decision("curvature of the grid", False, "map plane", "the grid has no projection", bound, effect)


_BYTES_PER_SAMPLE = 8 * 4 / 3
"""Size of a height sample with its share of the pyramid of maxima."""


def _parts(ground: Scene) -> Iterator[Decision]:
    """Yield a line for each seam between grids, and for each cropped grid."""
    if isinstance(ground, CroppedGround):
        yield from (_cut(grid) for grid in ground.grids)
        ground = ground.cropped
    while isinstance(ground, PaintedGround):
        ground = ground.ground
    while isinstance(ground, NestedGround):
        yield _seam(ground)
        ground = ground.outer


def plan_objects(scene: Scene, ground: Scene) -> Iterator[Decision]:
    """Yield a line for the objects that are left out."""
    if scene is ground:
        return
    from lidar_emu.scene.objects.populated_scene import SceneInMotion

    if isinstance(scene, SceneInMotion):
        scene = scene.still
    if isinstance(scene, CroppedGround) and scene is not ground:
        (cut,) = scene.grids
        yield Decision(
            "objects out of reach",
            False,
            f"{cut.retained} of {cut.samples} triangles in memory",
            "no beam of any pattern reaches them during the flight",
            "exact",
        )


def _cut(grid: CroppedGrid) -> Decision:
    saved_mb = (grid.samples - grid.retained) * _BYTES_PER_SAMPLE * 1e-6
    west_m, east_m, south_m, north_m = grid.area
    return Decision(
        "ground out of reach",
        False,
        f"{grid.retained} of {grid.samples} samples in memory: {east_m - west_m:.0f} m x {north_m - south_m:.0f} m",
        "no beam of any pattern reaches it during the flight",
        f"exact; saves {saved_mb:.0f} MB and {1 - grid.retained / grid.samples:.1%} of the pyramid",
    )


def _seam(nested: NestedGround) -> Decision:
    seam = nested.seam
    offset_m = round(seam.offset_m, 2) + 0.0  # never minus zero
    return Decision(
        "seam",
        True,
        f"blended over {seam.feather_m:.3g} m",
        f"{nested.inner.description}: {offset_m:+.2f} m ± {seam.scatter_m:.2f} m from the ground that it replaces",
        f"steps up to {seam.step_m:.2g} m",
    )
