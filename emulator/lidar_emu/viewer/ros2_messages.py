"""A flight as messages of ROS 2 over time: transforms, a path, point clouds, markers, numbers and events.

Lengths are in metres, in the site frame (east, north, up), as rep-103 has it. The types are those of Humble,
which later releases keep. Source: https://github.com/ros2/common_interfaces
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from functools import cache, partial
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore

from lidar_emu.files import whole_file
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.report.beam_colours import beam_rgb
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.runtime.port.packets import DeliveryStatus
from lidar_emu.viewer.flight_parts import Event, FlightPart, FlightParts, GroundMesh, beam_values
from lidar_emu.viewer.layouts import LATENESS

_STORE = get_typestore(Stores.ROS2_HUMBLE)
SITE, BODY = "site", "body"
# RViz places points by single-precision numbers alone.
_POINT = np.dtype(
    {
        "names": ("x", "y", "z", "range_m", "closing_speed_mps", "beam"),
        "formats": ("<f4", "<f4", "<f4", "<f8", "<f8", "u1"),
    }
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


def _vehicle_message(time_ns: int, position_m: FloatArray, site_from_body: FloatArray) -> Any:
    place, turn = _vector(position_m), _quaternion(site_from_body)
    transform = _new("geometry_msgs/msg/Transform", translation=place, rotation=turn)
    kind, header = "geometry_msgs/msg/TransformStamped", _header(time_ns)
    stamped = _new(kind, header=header, child_frame_id=BODY, transform=transform)
    return _new("tf2_msgs/msg/TFMessage", transforms=[stamped])


def _path_message(time_ns: int, position_m: FloatArray) -> Any:
    header = _header(time_ns)
    poses = [_new("geometry_msgs/msg/PoseStamped", header=header, pose=_pose(at_m)) for at_m in position_m]
    return _new("nav_msgs/msg/Path", header=header, poses=poses)


def _ground_message(time_ns: int, ground: GroundMesh) -> Any:
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


def _points_message(
    time_ns: int, points_m: FloatArray, range_m: FloatArray, closing_speed_mps: FloatArray, beam: IntArray
) -> Any:
    packed = np.empty(len(points_m), dtype=_POINT)
    packed["x"], packed["y"], packed["z"] = points_m.T
    packed["range_m"], packed["closing_speed_mps"], packed["beam"] = range_m, closing_speed_mps, beam
    assert _POINT.fields is not None
    of_field = partial(_new, "sensor_msgs/msg/PointField", count=1)
    fields = [
        of_field(name=name, offset=offset, datatype=_FIELD_TYPES[kind.str])
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


def _beams_message(
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
    nothing = np.empty(0, np.uint8)
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
        texture=_new("sensor_msgs/msg/CompressedImage", header=_header(time_ns), format="", data=nothing),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=_new("visualization_msgs/msg/MeshFile", filename="", data=nothing),
        mesh_use_embedded_materials=False,
    )


def _number(value: float) -> Any:
    return _new("std_msgs/msg/Float64", data=value)


def _new(kind: str, **values: Any) -> Any:
    return _STORE.types[kind](**values)


def _time(time_ns: int) -> Any:
    return _new("builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)


def _header(time_ns: int) -> Any:
    return _new("std_msgs/msg/Header", stamp=_time(time_ns), frame_id=SITE)


def _vector(vector: FloatArray) -> Any:
    x, y, z = vector.tolist()
    return _new("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _points(points_m: FloatArray) -> list[Any]:
    return [_new("geometry_msgs/msg/Point", x=x, y=y, z=z) for x, y, z in points_m.tolist()]


def _quaternion(wxyz: FloatArray) -> Any:
    w, x, y, z = wxyz.tolist()
    return _new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _pose(position_m: FloatArray) -> Any:
    (place,) = _points(position_m[None])
    return _new("geometry_msgs/msg/Pose", position=place, orientation=_quaternion(_LEVEL))


def _colour(red: float, green: float, blue: float) -> Any:
    return _new("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=1.0)


_PATH, _GROUND = "/path", "/ground"
STANDING = (_PATH, _GROUND)
"""Topics whose last message stands until the next."""
_WIDTH_SHARE = 0.007
"""Width of beams, as a share of the longest of their shot: narrower ones vanish where the whole flight is in view."""
_AGAIN_NS = 10**9
"""Foxglove Studio forgets, when one starts to play a file, what it drew of the first 0.1 s."""
_Messages = Iterator[tuple[int, str, Any]]
"""Nanoseconds since 1970, topic, message."""


def messages_of(part: FlightPart) -> _Messages:
    """Yield the messages of a part of a recording in the order of their times.

    Messages are stamped as the recording stamps its own topics: scenario time on the scenario's epoch.
    """
    run = part.run
    epoch_ns, measured = run.recording.epoch_ns, run.measurement
    parts = [_values(measured, beam, epoch_ns) for beam in range(measured.beam_count)]
    parts += [_lateness(run, epoch_ns), _events(part.events, epoch_ns)]
    if run.is_flight:
        parts += [_still(part, epoch_ns), _flight(part, epoch_ns)]
    return heapq.merge(*parts, key=itemgetter(0))


def _still(part: FlightPart, epoch_ns: int) -> _Messages:
    """What does not move: the ground and the path, at the first shot, and once again."""
    times_ns = _times_ns(part.run.measurement, 0, epoch_ns)
    again = (time_ns for time_ns in times_ns if time_ns >= times_ns[0] + _AGAIN_NS)
    for time_ns in (times_ns[0], *islice(again, 1)):
        if part.path_site_m is not None:
            yield time_ns, _PATH, _path_message(time_ns, part.path_site_m)
        if part.ground is not None:
            yield time_ns, _GROUND, _ground_message(time_ns, part.ground)


def _flight(part: FlightPart, epoch_ns: int) -> _Messages:
    measured = part.run.measurement
    valid = measured.range_valid
    rgb = np.array([beam_rgb(beam) for beam in range(measured.beam_count)], dtype=np.uint8)
    for shot, time_ns in enumerate(_times_ns(measured, 0, epoch_ns)):
        position_m, beams = measured.position_site_m[shot], np.flatnonzero(valid[shot])
        points_m, speed_mps = measured.point_site_m[shot, beams], measured.closing_speed_mps[shot, beams]
        yield time_ns, "/tf", _vehicle_message(time_ns, position_m, measured.site_from_body[shot])
        range_m = measured.range_m[shot, beams]
        width_m = _WIDTH_SHARE * float(range_m.max(initial=0.0))
        lines = _beams_message(time_ns, position_m, points_m, rgb[beams], width_m)
        yield time_ns, "/beams", lines
        yield time_ns, "/points", _points_message(time_ns, points_m, range_m, speed_mps, beams)


def _values(measured: Measurement, beam: int, epoch_ns: int) -> _Messages:
    values = {name: of_beams[:, beam].tolist() for name, of_beams in beam_values(measured).items()}
    for shot, time_ns in enumerate(_times_ns(measured, beam, epoch_ns)):
        for name, column in values.items():
            yield time_ns, f"/beam_{beam}/{name}", _number(column[shot])


def _lateness(run: RecordedRun, epoch_ns: int) -> _Messages:
    if not run.keeps_time:
        return
    due_ns = run.deliveries.due_ns[run.deliveries.status == DeliveryStatus.SENT]
    for time_ns, late_us in zip(due_ns.tolist(), run.lateness_us.tolist(), strict=True):
        yield epoch_ns + time_ns, f"/lateness/{LATENESS}", _number(late_us)


def _events(events: list[Event], epoch_ns: int) -> _Messages:
    for event in events:
        time_ns = epoch_ns + event.time_ns
        log = _new(
            "rcl_interfaces/msg/Log",
            stamp=_time(time_ns),
            level=_LEVELS[event.level],
            name="lidar_emu",
            msg=event.text,
            file="",
            function="",
            line=0,
        )
        yield time_ns, "/events", log


def _times_ns(measured: Measurement, beam: int, epoch_ns: int) -> list[int]:
    """Times of validity of a beam; a shot is stamped with beam 0's."""
    times_ns: list[int] = (epoch_ns + measured.time_ns[:, beam]).tolist()
    return times_ns


def write_ros2(run: RecordedRun, path: Path) -> list[str]:
    """Write the messages of a recording; returns what is missing, with the reasons.

    Raises:
        InputError: the path cannot be written.
        RunError: writing failed.
    """
    notes: list[str] = []
    part = FlightParts(notes, is_running=False).part(run)
    channels: dict[str, int] = {}
    with whole_file(path) as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="lidar-emu")
        for time_ns, topic, message in messages_of(part):
            if topic not in channels:
                kind, definition = schema_of(message)
                schema = writer.register_schema(kind, "ros2msg", definition)
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], time_ns, encoded(message), time_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return notes
