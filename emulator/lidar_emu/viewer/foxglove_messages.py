"""Foxglove's schemas for one flight: transforms, points, lines and triangles in the site frame (east, north, up).

Source: https://docs.foxglove.dev/docs/visualization/message-schemas
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.viewer.events import Event
from lidar_emu.viewer.ground_mesh import GroundMesh
from lidar_emu.viewer.message_stream import Numbers

SITE, BODY = "site", "body"
_PATH = Color(r=0.82, g=0.29, b=0.36, a=1.0)
_LINE_PIXELS = 2.0
_POINT = np.dtype(
    [(name, "<f8") for name in ("x", "y", "z", "range_m", "closing_speed_mps")] + [("beam", "u1")]
)
_NUMERIC_TYPES = {"<f8": PackedElementField.FLOAT64, "|u1": PackedElementField.UINT8}
_LEVELS = {"INFO": Log.INFO, "WARN": Log.WARNING, "ERROR": Log.ERROR}


def _timestamp(time_ns: int) -> Timestamp:
    """An instant, from nanoseconds since 1970."""
    return Timestamp(seconds=time_ns // 10**9, nanos=time_ns % 10**9)


def vehicle(time_ns: int, position_m: FloatArray, site_from_body: FloatArray) -> FrameTransforms:
    """The vehicle's position and attitude."""
    w, x, y, z = site_from_body.tolist()
    transform = FrameTransform(
        timestamp=_timestamp(time_ns),
        parent_frame_id=SITE,
        child_frame_id=BODY,
        translation=Vector3(**dict(zip("xyz", position_m.tolist(), strict=True))),
        rotation=Quaternion(x=x, y=y, z=z, w=w),
    )
    return FrameTransforms(transforms=[transform])


def points(
    time_ns: int, points_m: FloatArray, range_m: FloatArray, closing_speed_mps: FloatArray, beam: IntArray
) -> PointCloud:
    """Points of a shot, each with what its beam measured."""
    packed = np.empty(len(points_m), dtype=_POINT)
    packed["x"], packed["y"], packed["z"] = points_m.T
    packed["range_m"], packed["closing_speed_mps"], packed["beam"] = range_m, closing_speed_mps, beam
    assert _POINT.fields is not None
    fields = [
        PackedElementField(name=name, offset=offset, type=_NUMERIC_TYPES[kind.str])
        for name, (kind, offset, *_) in _POINT.fields.items()
    ]
    return PointCloud(
        timestamp=_timestamp(time_ns),
        frame_id=SITE,
        pose=_no_motion(),
        point_stride=_POINT.itemsize,
        fields=fields,
        data=packed.tobytes(),
    )


def beams(time_ns: int, from_m: FloatArray, points_m: FloatArray, rgb: NDArray[np.uint8]) -> SceneUpdate:
    """Lines from the vehicle to the points of a shot; they replace those of the shot before."""
    ends_m = np.stack([np.broadcast_to(from_m, points_m.shape), points_m], axis=1).reshape(-1, 3)
    lines = _line(LinePrimitive.LINE_LIST, ends_m)
    lines.colors.extend(_colours(np.repeat(rgb, 2, axis=0)))
    return _entity(time_ns, "beams", lines=[lines])


def path(time_ns: int, position_m: FloatArray) -> SceneUpdate:
    """The whole path."""
    line = _line(LinePrimitive.LINE_STRIP, position_m)
    line.color.CopyFrom(_PATH)
    return _entity(time_ns, "path", lines=[line])


def ground(time_ns: int, ground: GroundMesh) -> SceneUpdate:
    """The ground."""
    triangles = TriangleListPrimitive(
        pose=_no_motion(),
        points=_points(ground.vertices_m),
        colors=_colours(np.stack([ground.grey] * 3, axis=1)),
        indices=ground.triangles.ravel().tolist(),
    )
    return _entity(time_ns, "ground", triangles=[triangles])


def event(time_ns: int, event: Event) -> Log:
    """An event."""
    return Log(
        timestamp=_timestamp(time_ns), level=_LEVELS[event.level], message=event.text, name="lidar-emu"
    )


def numbers(time_ns: int, numbers: Numbers) -> list[tuple[str, Any]]:
    """Values to plot, in one message."""
    kind = _numbers_type(numbers.kind, tuple(numbers.values))
    return [(numbers.topic, kind(timestamp=_timestamp(time_ns), **numbers.values))]


@cache
def _numbers_type(name: str, fields: tuple[str, ...]) -> Any:
    """A message type of our own: `timestamp`, and a double for each field."""
    file = descriptor_pb2.FileDescriptorProto(
        name=f"lidar_emu/{name}.proto", package="lidar_emu", syntax="proto3"
    )
    file.dependency.append("google/protobuf/timestamp.proto")
    message = file.message_type.add(name=name)
    kinds = descriptor_pb2.FieldDescriptorProto
    message.field.add(
        name="timestamp",
        number=1,
        type=kinds.TYPE_MESSAGE,
        type_name=".google.protobuf.Timestamp",
        label=kinds.LABEL_OPTIONAL,
    )
    for number, field in enumerate(fields, 2):
        message.field.add(name=field, number=number, type=kinds.TYPE_DOUBLE, label=kinds.LABEL_OPTIONAL)
    descriptor_pool.Default().Add(file)
    described = descriptor_pool.Default().FindMessageTypeByName(f"lidar_emu.{name}")
    return message_factory.GetMessageClass(described)


def _entity(time_ns: int, name: str, **primitives: Any) -> SceneUpdate:
    entity = SceneEntity(timestamp=_timestamp(time_ns), frame_id=SITE, id=name, **primitives)
    return SceneUpdate(entities=[entity])


def _line(kind: Any, points_m: FloatArray) -> LinePrimitive:
    return LinePrimitive(
        type=kind, pose=_no_motion(), thickness=_LINE_PIXELS, scale_invariant=True, points=_points(points_m)
    )


def _no_motion() -> Pose:
    return Pose(position=Vector3(), orientation=Quaternion(w=1.0))


def _points(points_m: FloatArray) -> list[Point3]:
    return [Point3(x=x, y=y, z=z) for x, y, z in points_m.tolist()]


def _colours(rgb: NDArray[np.uint8]) -> list[Color]:
    return [Color(r=red, g=green, b=blue, a=1.0) for red, green, blue in (rgb / 255).tolist()]
