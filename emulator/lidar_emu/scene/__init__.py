"""The scene that beams hit: ground and objects, and the casting of rays onto them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from lidar_emu.scenario import site
from lidar_emu.scenario.ground import Mesh
from lidar_emu.scene.analytic_grounds import PlaneGround, SphereGround
from lidar_emu.scene.ray_hits import Hits, Scene

if TYPE_CHECKING:
    from lidar_emu.scene.ray_reach import Reach

__all__ = ["Hits", "Scene", "build_scene"]


def build_scene(part: site.Site) -> Scene:
    """Build the ground of a site with its objects, in the site frame.

    Raises:
        InputError: an elevation file or a mesh cannot be used as the site specifies.
    """
    return with_objects(build_ground(part), part)


def with_objects(ground: Scene, part: site.Site, reach: Reach | None = None) -> Scene:
    """Place the objects of a site on its ground, as far as the rays of a run can reach them."""
    if not part.objects:
        return ground
    from lidar_emu.scene.objects.build import populated

    return populated(ground, part, reach)


def build_ground(part: site.Site, reach: Reach | None = None) -> Scene:
    """Build the ground of a site without its objects, in the site frame.

    Args:
        part: the site.
        reach: the rays of the run, so that what they cannot meet is left out; None: all is built.

    Raises:
        InputError: an elevation file or a mesh cannot be used as the site specifies.
    """
    if isinstance(part.ground, site.Nested):
        return _grids(part, part.ground.grids, reach)
    if isinstance(part.ground, site.AnyGrid):
        return _grids(part, [part.ground], reach)
    if isinstance(part.ground, site.Plane):
        return _plane(part, part.ground, part.origin_altitude_m or 0.0)
    if isinstance(part.ground, Mesh):
        from lidar_emu.scene.mesh.file import read_mesh
        from lidar_emu.scene.mesh.ground import place_mesh

        file = read_mesh(part.ground.file, part.ground.unit)
        return place_mesh(file, part.ground, part)
    return SphereGround(part.body.radius_m, part.origin_altitude_m or 0.0, part.surface.reflectance)


def _plane(part: site.Site, ground: site.Plane, origin_altitude_m: float) -> PlaneGround:
    azimuth_rad = math.radians(ground.downhill_azimuth_deg)
    slope_rad = math.radians(ground.slope_deg)
    return PlaneGround(slope_rad, azimuth_rad, origin_altitude_m, part.surface.reflectance)


def _grids(part: site.Site, grids: list[site.AnyGrid], reach: Reach | None) -> Scene:
    from lidar_emu.scene.mosaic.grids import Beyond, Layer, join_grids, read_layers

    def read() -> tuple[list[Layer], Beyond]:
        layers, altitude_m = read_layers(part, grids)
        around: dict[str, Beyond] = {
            "none": None,
            "plane": _plane(part, site.Plane(kind="plane"), altitude_m),
            # The sphere of the body at the altitude of the site: it passes through the origin, as the plane does.
            "sphere": SphereGround(part.body.radius_m + altitude_m, 0.0, part.surface.reflectance),
        }
        return layers, around[grids[-1].beyond]

    return join_grids(read, reach)
