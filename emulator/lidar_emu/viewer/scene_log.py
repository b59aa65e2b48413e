"""The flight in three dimensions, for Rerun: ground, vehicle, beams and points in the site frame (east, north, up)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.exports import dark_to_bright_rgb
from lidar_emu.report.ground_below import Extent
from lidar_emu.viewer.ground_mesh import GroundMesh, ground_mesh
from lidar_emu.viewer.timeline import seconds, send

if TYPE_CHECKING:
    import rerun as rr

    from lidar_emu.scene.ray_hits import Scene

_AXES_RGB = [(214, 69, 65), (46, 160, 67), (56, 108, 214)]


def log_scene(stream: rr.RecordingStream, measured: Measurement, scene: Scene | None, extent: Extent) -> None:
    """Log the flight, and the ground within an extent; without a scene there is none."""
    import rerun as rr

    stream.log("site", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    if scene is not None:
        _log_ground(stream, ground_mesh(scene, extent))
    _log_vehicle(stream, measured, extent)
    _log_beams(stream, measured)


def _log_ground(stream: rr.RecordingStream, ground: GroundMesh) -> None:
    import rerun as rr

    mesh = rr.Mesh3D(
        vertex_positions=ground.vertices_m,
        triangle_indices=ground.triangles,
        vertex_colors=np.stack([ground.grey] * 3, axis=1),
    )
    stream.log("site/ground", mesh, static=True)


def _log_vehicle(stream: rr.RecordingStream, measured: Measurement, extent: Extent) -> None:
    """Log the path, and the body frame's axes where the vehicle is: x red, y green, z blue."""
    import rerun as rr

    length_m = 0.06 * float(np.max(extent.high_m - extent.low_m))
    position_m = measured.position_site_m
    stream.log("site/path", rr.LineStrips3D([position_m], colors=[(209, 73, 91)]), static=True)
    stream.log(
        "site/vehicle",
        rr.Arrows3D(vectors=length_m * np.eye(3), colors=_AXES_RGB),
        static=True,
    )
    x_y_z_w = np.roll(measured.site_from_body, -1, axis=1)
    columns = rr.Transform3D.columns(translation=position_m, quaternion=x_y_z_w)
    send(stream, "site/vehicle", shot_times_s(measured), columns)


def _log_beams(stream: rr.RecordingStream, measured: Measurement) -> None:
    """Log for each shot its beams, coloured by range, and its points, coloured by speed."""
    import rerun as rr

    valid = measured.range_valid
    counts = valid.sum(axis=1)
    shot, _ = np.nonzero(valid)
    points_m = measured.point_site_m[valid]
    beams_m = np.stack([measured.position_site_m[shot], points_m], axis=1)
    of_range = rr.LineStrips3D.columns(
        strips=list(beams_m), colors=dark_to_bright_rgb(measured.range_m[valid])
    )
    send(stream, "site/beams", shot_times_s(measured), of_range.partition(counts))
    speed_mps = np.nan_to_num(np.abs(measured.closing_speed_mps[valid]))
    of_speed = rr.Points3D.columns(positions=points_m, colors=dark_to_bright_rgb(speed_mps))
    send(stream, "site/points", shot_times_s(measured), of_speed.partition(counts))


def shot_times_s(measured: Measurement) -> FloatArray:
    """(shots,) Time of validity of each shot's first beam."""
    return seconds(measured.time_ns[:, 0])
