"""Reading of a site's elevation file, of any format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lidar_emu.errors import InputError
from lidar_emu.files import check_file
from lidar_emu.scenario.site import ElevationGrid
from lidar_emu.scene.terrain.flat import FlatMap, placed_flat, read_flat_raster
from lidar_emu.scene.terrain.model import Terrain
from lidar_emu.scene.terrain.npz import read_npz
from lidar_emu.scene.terrain.on_body import read_on_body
from lidar_emu.scene.terrain.points import holds_points, read_points
from lidar_emu.scene.terrain.raster import open_raster


def read_terrain(ground: ElevationGrid) -> Terrain:
    """Read the elevation file of a site, around the origin that the site names.

    Args:
        ground: the scenario's keys of the file.

    Raises:
        InputError: the file is missing or unreadable, is not an elevation grid, or does not include the origin.
    """
    _check_is_there(ground)
    if _is_npz(ground):
        return _flat(ground, read_npz(ground))
    if holds_points(ground):
        return _flat(ground, read_points(ground))
    with open_raster(ground.file) as file:
        if _is_on_body(ground, file):
            return read_on_body(ground, file)
        return _flat(ground, read_flat_raster(ground, file))


def _flat(ground: ElevationGrid, flat: FlatMap) -> Terrain:
    if ground.half_size_m is not None:
        remedy = "leave it out: a flat grid is taken whole"
        raise InputError(ground.file, "ground.half_size_m", ground.half_size_m, remedy)
    return placed_flat(flat, ground)


def lies_flat(ground: ElevationGrid) -> bool:
    """Whether the map plane of a site's file is taken as the horizontal plane."""
    _check_is_there(ground)
    if _is_npz(ground) or holds_points(ground):
        return True
    with open_raster(ground.file) as file:
        return not _is_on_body(ground, file)


def _check_is_there(ground: ElevationGrid) -> None:
    kinds = "a GeoTIFF, PDS label, ESRI ASCII grid, point cloud (.las, .laz, .xyz) or .npz"
    check_file(Path(ground.file), f"use {kinds}")


def _is_npz(ground: ElevationGrid) -> bool:
    return ground.file.lower().endswith(".npz")


def _is_on_body(ground: ElevationGrid, file: Any) -> bool:
    """Whether the file's coordinates lie on a body and are used; a map in metres around a test bench has none."""
    return (
        ground.placement == "projected"
        and bool(file.crs)
        and (file.crs.is_projected or file.crs.is_geographic)
    )
