"""Messages of ROS 2 for one flight: transforms, a path, point clouds, markers, numbers and events.

Lengths are in metres, in the site frame (east, north, up), as rep-103 has it. The types are those of Humble,
which later releases keep. Source: https://github.com/ros2/common_interfaces
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.viewer.flight_parts import Event, GroundMesh

_STORE = get_typestore(Stores.ROS2_HUMBLE)
SITE, BODY = "site", "body"
# RViz places points by single-precision numbers alone.
_POINT = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("range_m", "<f8"),
        ("closing_speed_mps", "<f8"),
        ("beam", "u1"),
    ]
)
_FIELD_TYPES = {"<f4": 7, "<f8": 8, "|u1": 2}
_LEVELS = {"INFO": 20, "WARN": 30, "ERROR": 40}
_LINE_LIST, _TRIANGLE_LIST, _MODIFY = 5, 11, 0
_LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def schema_of(message: Any) -> tuple[str, bytes]:
    """The type of a message and its definition, with those that it contains, in the encoding `ros2msg`."""
    return message.__msgtype__, _definition(message.__msgtype__)


@cache
def _definition(kind: str) -> bytes:
    definition, _ = _STORE.generate_msgdef(kind, ros_version=2)
    return definition.encode()


def encoded(message: Any) -> bytes:
    """A message in CDR."""
    return bytes(_STORE.serialize_cdr(message, message.__msgtype__))


def vehicle(time_ns: int, position_m: FloatArray, site_from_body: FloatArray) -> Any:
    """The vehicle's position and attitude, a tf2_msgs/msg/TFMessage."""
    transform = _new(
        "geometry_msgs/msg/Transform",
        translation=_vector(position_m),
        rotation=_quaternion(site_from_body),
    )
    stamped = _new(
        "geometry_msgs/msg/TransformStamped",
        header=_header(time_ns),
        child_frame_id=BODY,
        transform=transform,
    )
    return _new("tf2_msgs/msg/TFMessage", transforms=[stamped])


def path(time_ns: int, position_m: FloatArray) -> Any:
    """The whole path, a nav_msgs/msg/Path."""
    header = _header(time_ns)
    poses = [_new("geometry_msgs/msg/PoseStamped", header=header, pose=_pose(at_m)) for at_m in position_m]
    return _new("nav_msgs/msg/Path", header=header, poses=poses)


def ground(time_ns: int, ground: GroundMesh) -> Any:
    """The ground's triangles, shaded by slope, a visualization_msgs/msg/Marker."""
    # Vertices and shades are shared by the triangles around them: a message has a hundred thousand.
    vertices = np.array(_points(ground.vertices_m), dtype=object)
    shades = np.array([_colour(grey, grey, grey) for grey in np.linspace(0.0, 1.0, 256).tolist()])
    corners = ground.triangles.ravel()
    return _marker(
        time_ns,
        "ground",
        _TRIANGLE_LIST,
        scale_m=np.ones(3),
        points=vertices[corners].tolist(),
        colors=shades[ground.grey[corners]].tolist(),
    )


def points(
    time_ns: int, points_m: FloatArray, range_m: FloatArray, closing_speed_mps: FloatArray, beam: IntArray
) -> Any:
    """Points of a shot, each with what its beam measured, a sensor_msgs/msg/PointCloud2."""
    packed = np.empty(len(points_m), dtype=_POINT)
    packed["x"], packed["y"], packed["z"] = points_m.T
    packed["range_m"], packed["closing_speed_mps"], packed["beam"] = range_m, closing_speed_mps, beam
    assert _POINT.fields is not None
    fields = [
        _new(
            "sensor_msgs/msg/PointField",
            name=name,
            offset=offset,
            datatype=_FIELD_TYPES[kind.str],
            count=1,
        )
        for name, (kind, offset, *_) in _POINT.fields.items()
    ]
    return _new(
        "sensor_msgs/msg/PointCloud2",
        header=_header(time_ns),
        height=1,
        width=len(packed),
        fields=fields,
        is_bigendian=False,
        point_step=packed.itemsize,
        row_step=packed.nbytes,
        data=np.frombuffer(packed.tobytes(), np.uint8),
        is_dense=True,
    )


def beams(
    time_ns: int, from_m: FloatArray, points_m: FloatArray, rgb: NDArray[np.uint8], width_m: float
) -> Any:
    """Lines from the vehicle to the points of a shot, a visualization_msgs/msg/Marker; they replace those before."""
    ends_m = np.stack([np.broadcast_to(from_m, points_m.shape), points_m], axis=1).reshape(-1, 3)
    return _marker(
        time_ns,
        "beams",
        _LINE_LIST,
        scale_m=np.array([width_m, 0.0, 0.0]),
        points=_points(ends_m),
        colors=[_colour(*of_point) for of_point in (np.repeat(rgb, 2, axis=0) / 255).tolist()],
    )


def _marker(
    time_ns: int, name: str, kind: int, *, scale_m: FloatArray, points: list[Any], colors: list[Any]
) -> Any:
    return _new(
        "visualization_msgs/msg/Marker",
        header=_header(time_ns),
        ns=name,
        id=0,
        type=kind,
        action=_MODIFY,
        pose=_pose(np.zeros(3)),
        scale=_vector(scale_m),
        color=_colour(1.0, 1.0, 1.0),
        lifetime=_new("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=False,
        points=points,
        colors=colors,
        texture_resource="",
        texture=_new(
            "sensor_msgs/msg/CompressedImage",
            header=_header(time_ns),
            format="",
            data=np.empty(0, np.uint8),
        ),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=_new("visualization_msgs/msg/MeshFile", filename="", data=np.empty(0, np.uint8)),
        mesh_use_embedded_materials=False,
    )


def number(value: float) -> Any:
    """A value to plot, a std_msgs/msg/Float64."""
    return _new("std_msgs/msg/Float64", data=value)


def event(time_ns: int, event: Event) -> Any:
    """An event, a rcl_interfaces/msg/Log."""
    return _new(
        "rcl_interfaces/msg/Log",
        stamp=_time(time_ns),
        level=_LEVELS[event.level],
        name="lidar_emu",
        msg=event.text,
        file="",
        function="",
        line=0,
    )


def _new(kind: str, **values: Any) -> Any:
    return _STORE.types[kind](**values)


def _time(time_ns: int) -> Any:
    return _new("builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)


def _header(time_ns: int) -> Any:
    return _new("std_msgs/msg/Header", stamp=_time(time_ns), frame_id=SITE)


def _xyz(vector: FloatArray) -> dict[str, float]:
    return dict(zip("xyz", vector.tolist(), strict=True))


def _vector(vector: FloatArray) -> Any:
    return _new("geometry_msgs/msg/Vector3", **_xyz(vector))


def _points(points_m: FloatArray) -> list[Any]:
    return [_new("geometry_msgs/msg/Point", x=x, y=y, z=z) for x, y, z in points_m.tolist()]


def _quaternion(wxyz: FloatArray) -> Any:
    w, x, y, z = wxyz.tolist()
    return _new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _pose(position_m: FloatArray) -> Any:
    place = _new("geometry_msgs/msg/Point", **_xyz(position_m))
    return _new("geometry_msgs/msg/Pose", position=place, orientation=_quaternion(_LEVEL))


def _colour(red: float, green: float, blue: float) -> Any:
    return _new("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=1.0)
