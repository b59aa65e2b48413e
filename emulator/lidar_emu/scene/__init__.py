"""What the beams hit: plane, sphere and elevation grid, and the casting of rays onto them."""

from lidar_emu.scene.build import build_scene
from lidar_emu.scene.ray_hits import Hits, Scene

__all__ = ["Hits", "Scene", "build_scene"]
