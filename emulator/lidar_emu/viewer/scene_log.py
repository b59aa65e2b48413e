"""The flight in three dimensions, for Rerun: ground, vehicle, beams and points in the site frame (east, north, up)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.exports import dark_to_bright_rgb
from lidar_emu.report.ground_below import Extent
from lidar_emu.viewer.flight_parts import FlightPart
from lidar_emu.viewer.ground_mesh import GroundMesh
from lidar_emu.viewer.timeline import seconds, send
from lidar_emu.viewer.views import size_m

if TYPE_CHECKING:
    import rerun as rr

_AXES_RGB = [(214, 69, 65), (46, 160, 67), (56, 108, 214)]


def log_scene(stream: rr.RecordingStream, part: FlightPart) -> None:
    """Log a part of the flight."""
    import rerun as rr

    measured = part.run.measurement
    if part.extent is not None:
        stream.log("site", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        _log_axes(stream, part.extent)
    if part.ground is not None:
        _log_ground(stream, part.ground)
    if part.path_site_m is not None:
        path = rr.LineStrips3D([part.path_site_m], colors=[(209, 73, 91)])
        stream.log("site/path", path, static=True)
    _log_vehicle(stream, measured)
    _log_beams(stream, part)


def _log_ground(stream: rr.RecordingStream, ground: GroundMesh) -> None:
    import rerun as rr

    mesh = rr.Mesh3D(
        vertex_positions=ground.vertices_m,
        triangle_indices=ground.triangles,
        vertex_colors=np.stack([ground.grey] * 3, axis=1),
    )
    stream.log("site/ground", mesh, static=True)


def _log_axes(stream: rr.RecordingStream, extent: Extent) -> None:
    """Log the body frame's axes: x red, y green, z blue."""
    import rerun as rr

    length_m = 0.06 * size_m(extent)
    axes = rr.Arrows3D(vectors=length_m * np.eye(3), colors=_AXES_RGB)
    stream.log("site/vehicle", axes, static=True)


def _log_vehicle(stream: rr.RecordingStream, measured: Measurement) -> None:
    import rerun as rr

    x_y_z_w = np.roll(measured.site_from_body, -1, axis=1)
    columns = rr.Transform3D.columns(translation=measured.position_site_m, quaternion=x_y_z_w)
    send(stream, "site/vehicle", shot_times_s(measured), columns)


def _log_beams(stream: rr.RecordingStream, part: FlightPart) -> None:
    import rerun as rr

    measured = part.run.measurement
    valid = measured.range_valid
    counts = valid.sum(axis=1)
    shot, _ = np.nonzero(valid)
    points_m = measured.point_site_m[valid]
    beams_m = np.stack([measured.position_site_m[shot], points_m], axis=1)
    range_rgb = dark_to_bright_rgb(measured.range_m[valid], part.range_span_m)
    of_range = rr.LineStrips3D.columns(strips=list(beams_m), colors=range_rgb)
    send(stream, "site/beams", shot_times_s(measured), of_range.partition(counts))
    speed_mps = np.nan_to_num(np.abs(measured.closing_speed_mps[valid]))
    speed_rgb = dark_to_bright_rgb(speed_mps, part.speed_span_mps)
    of_speed = rr.Points3D.columns(positions=points_m, colors=speed_rgb)
    send(stream, "site/points", shot_times_s(measured), of_speed.partition(counts))


def shot_times_s(measured: Measurement) -> FloatArray:
    """(shots,) Time of validity of each shot's first beam."""
    return seconds(measured.time_ns[:, 0])
