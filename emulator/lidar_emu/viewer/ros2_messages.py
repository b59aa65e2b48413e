"""Messages of ROS 2 for one flight, in the site frame (east, north, up), as rep-103 has it.

The types are those of the release Humble, which later ones keep.
Source: https://github.com/ros2/common_interfaces
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.viewer.events import Event
from lidar_emu.viewer.ground_mesh import GroundMesh
from lidar_emu.viewer.message_stream import Numbers

STORE = get_typestore(Stores.ROS2_HUMBLE)
SITE, BODY = "site", "body"
_PLACE = np.dtype([(name, "<f4") for name in "xyz"])
"""RViz places points by single-precision numbers alone."""
_POINT = np.dtype([*_PLACE.descr, ("range_m", "<f8"), ("closing_speed_mps", "<f8"), ("beam", "u1")])
_FIELD_TYPES = {"<f4": 7, "<f8": 8, "|u1": 2}
_LEVELS = {"INFO": 20, "WARN": 30, "ERROR": 40}
_LINE_LIST, _MODIFY = 5, 0
_LINE_WIDTH_M = 0.5
_LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


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
    """The ground's vertices, a sensor_msgs/msg/PointCloud2."""
    vertices_m = ground.vertices_m[np.unique(ground.triangles)]
    packed = np.empty(len(vertices_m), dtype=_PLACE)
    packed["x"], packed["y"], packed["z"] = vertices_m.T
    return _point_cloud(time_ns, packed)


def points(
    time_ns: int, points_m: FloatArray, range_m: FloatArray, closing_speed_mps: FloatArray, beam: IntArray
) -> Any:
    """Points of a shot, each with what its beam measured, a sensor_msgs/msg/PointCloud2."""
    packed = np.empty(len(points_m), dtype=_POINT)
    packed["x"], packed["y"], packed["z"] = points_m.T
    packed["range_m"], packed["closing_speed_mps"], packed["beam"] = range_m, closing_speed_mps, beam
    return _point_cloud(time_ns, packed)


def _point_cloud(time_ns: int, points: NDArray[np.void]) -> Any:
    kinds = points.dtype.fields
    assert kinds is not None
    fields = [
        _new(
            "sensor_msgs/msg/PointField",
            name=name,
            offset=offset,
            datatype=_FIELD_TYPES[kind.str],
            count=1,
        )
        for name, (kind, offset, *_) in kinds.items()
    ]
    return _new(
        "sensor_msgs/msg/PointCloud2",
        header=_header(time_ns),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=points.itemsize,
        row_step=points.nbytes,
        data=np.frombuffer(points.tobytes(), np.uint8),
        is_dense=True,
    )


def beams(time_ns: int, from_m: FloatArray, points_m: FloatArray, rgb: NDArray[np.uint8]) -> Any:
    """Lines from the vehicle to the points of a shot, a visualization_msgs/msg/Marker; they replace those before."""
    start = _new("geometry_msgs/msg/Point", **_xyz(from_m))
    ends = [[start, _new("geometry_msgs/msg/Point", **_xyz(point_m))] for point_m in points_m]
    colours = [_colour(red, green, blue) for red, green, blue in (rgb / 255).tolist()]
    return _new(
        "visualization_msgs/msg/Marker",
        header=_header(time_ns),
        ns="beams",
        id=0,
        type=_LINE_LIST,
        action=_MODIFY,
        pose=_pose(np.zeros(3)),
        scale=_vector(np.array([_LINE_WIDTH_M, 0.0, 0.0])),
        color=_colour(1.0, 1.0, 1.0),
        lifetime=_new("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=False,
        points=[each for both in ends for each in both],
        colors=[each for each in colours for _ in range(2)],
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


def numbers(time_ns: int, numbers: Numbers) -> list[tuple[str, Any]]:  # noqa: ARG001
    """Values to plot: a topic and a std_msgs/msg/Float64 for each."""
    return [
        (f"{numbers.topic}/{name}", _new("std_msgs/msg/Float64", data=value))
        for name, value in numbers.values.items()
    ]


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
    return STORE.types[kind](**values)


def _time(time_ns: int) -> Any:
    return _new("builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)


def _header(time_ns: int) -> Any:
    return _new("std_msgs/msg/Header", stamp=_time(time_ns), frame_id=SITE)


def _xyz(vector: FloatArray) -> dict[str, float]:
    return dict(zip("xyz", vector.tolist(), strict=True))


def _vector(vector: FloatArray) -> Any:
    return _new("geometry_msgs/msg/Vector3", **_xyz(vector))


def _quaternion(wxyz: FloatArray) -> Any:
    w, x, y, z = wxyz.tolist()
    return _new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _pose(position_m: FloatArray) -> Any:
    place = _new("geometry_msgs/msg/Point", **_xyz(position_m))
    return _new("geometry_msgs/msg/Pose", position=place, orientation=_quaternion(_LEVEL))


def _colour(red: float, green: float, blue: float) -> Any:
    return _new("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=1.0)
