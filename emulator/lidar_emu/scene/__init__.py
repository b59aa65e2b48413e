"""The scene that beams hit: ground and objects, and the casting of rays onto them."""

from lidar_emu.scene.build import build_scene
from lidar_emu.scene.ray_hits import Hits, Scene

__all__ = ["Hits", "Scene", "build_scene"]
