"""The ground below a flight as triangles, in the site frame (east, north, up)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.errors import InputError
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.report.ground_below import Extent, sample_ground, slope_to_sun
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import build_model

if TYPE_CHECKING:
    from lidar_emu.flight.flight import Flight
    from lidar_emu.scene.ray_hits import Scene

SAMPLES = 250
"""Vertices of the ground along each axis: a browser without a graphics processor turns them smoothly."""
_GREY, _CONTRAST = 150, 70


class GroundMesh(NamedTuple):
    """Triangles, shaded by their slope."""

    vertices_m: FloatArray
    """(vertices, 3)"""
    triangles: IntArray
    """(triangles, 3) Vertices of each."""
    grey: NDArray[np.uint8]
    """(vertices,)"""


def flight_of(run: RecordedRun, notes: list[str]) -> Flight | None:
    """Build the flight of the run; None, with a note, if files that the scenario names are missing."""
    try:
        model = build_model(run.recording.scenario)
    except InputError as error:
        notes.append(f"no ground: the scenario cannot be built here ({error})")
        return None
    return model.flight if isinstance(model, FlightModel) else None


def ground_mesh(scene: Scene, extent: Extent) -> GroundMesh:
    """Sample the ground within an extent."""
    ground_m = sample_ground(scene, extent, SAMPLES)
    shade = np.zeros(ground_m.shape[:2])
    shade[:-1, :-1] = np.nan_to_num(slope_to_sun(ground_m))
    grey = (_GREY + _CONTRAST * shade).astype(np.uint8).ravel()
    triangles = ground_triangles(np.isfinite(ground_m[..., 2]))
    return GroundMesh(np.nan_to_num(ground_m.reshape(-1, 3)), triangles, grey)


def ground_triangles(known: BoolArray) -> IntArray:
    """(triangles, 3) Vertices of two triangles for each square of a grid whose four corners are known."""
    rows, columns = known.shape
    vertex = np.arange(rows * columns).reshape(rows, columns)
    whole = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]
    south_west, south_east = vertex[:-1, :-1][whole], vertex[:-1, 1:][whole]
    north_west, north_east = vertex[1:, :-1][whole], vertex[1:, 1:][whole]
    lower = np.stack([south_west, south_east, north_east], axis=1)
    upper = np.stack([south_west, north_east, north_west], axis=1)
    return np.concatenate([lower, upper]).astype(np.int64)
