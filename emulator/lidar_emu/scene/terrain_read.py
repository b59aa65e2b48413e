"""The elevation file of a site, whatever its kind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lidar_emu.errors import Finding, InputError
from lidar_emu.scenario.site import Grid
from lidar_emu.scene.terrain import Terrain
from lidar_emu.scene.terrain_flat import placed_flat, read_flat_raster
from lidar_emu.scene.terrain_local import read_on_body
from lidar_emu.scene.terrain_npz import read_npz
from lidar_emu.scene.terrain_raster import open_raster


def read_terrain(ground: Grid) -> Terrain:
    """The elevation file of a site, around the origin that the site names.

    Raises:
        InputError: the file is not there, cannot be read, is no elevation grid, or does not reach the origin.
    """
    if not Path(ground.file).is_file():
        allowed = "allowed: GeoTIFF, PDS label, ESRI ASCII grid or .npz"
        raise InputError(ground.file, None, Finding("no such file"), allowed)
    if ground.file.lower().endswith(".npz"):
        return placed_flat(read_npz(ground), ground)
    with open_raster(ground.file) as file:
        if ground.placement == "projected" and _is_on_a_body(file.crs):
            return read_on_body(ground, file)
        return placed_flat(read_flat_raster(ground, file), ground)


def _is_on_a_body(reference: Any) -> bool:
    """Whether a file's coordinates are those of a body: a map in metres around a bench has none."""
    return bool(reference) and (reference.is_projected or reference.is_geographic)
