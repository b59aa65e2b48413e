"""Seams and cropped parts of a flight's elevation grids, as lines of a plan."""

from __future__ import annotations

from collections.abc import Iterator

from lidar_emu.plan.plan import Decision
from lidar_emu.scene.mosaic.grids import PaintedGround
from lidar_emu.scene.mosaic.nested import NestedGround
from lidar_emu.scene.ray_hits import Scene
from lidar_emu.scene.ray_reach import CroppedGrid, CroppedGround

_BYTES_PER_SAMPLE = 8 * 4 / 3
"""Size of a height sample with its share of the pyramid of maxima."""


def plan_parts(ground: Scene) -> Iterator[Decision]:
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
