"""What each viewer shows of a flight, and a layout for Foxglove.

Names of panels and settings: Foxglove Studio 1.48, the last release with public sources, and later ones.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from lidar_emu.files import whole_file
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.beam_colours import beam_colour
from lidar_emu.report.ground_survey import Extent, extent_of
from lidar_emu.report.recorded_run import RecordedRun

LATENESS = "lateness_us"
POINTS_S = 10.0
"""Points of these last seconds are shown."""
_PLOTS = {
    "range_m": "Range (m)",
    "closing_speed_mps": "Closing speed (m/s)",
    "range_error_m": "Range error (m)",
    "closing_speed_error_mps": "Closing speed error (m/s)",
    LATENESS: "Lateness (us)",
}
_FLAT_SHIFT = 0.2
"""A flat box lies low in the picture: this share lowers the view, and brings it nearer."""
_FROM_CENTRE = np.array([-0.55, -0.93, 0.46])
DARK_RGB = (13, 14, 19)
"""Background of the flight."""
PATH_RGB = (242, 233, 208)


def plots(keeps_time: bool) -> dict[str, str]:
    """Titles of the quantities plotted, by name; without deadlines of the packets there is no lateness."""
    return {name: title for name, title in _PLOTS.items() if keeps_time or name != LATENESS}


def size_m(extent: Extent) -> float:
    """Longest side of the box."""
    return float((extent.high_m - extent.low_m).max())


def target_and_eye_m(extent: Extent) -> tuple[FloatArray, FloatArray]:
    """Where a camera with a wide field looks at, and where it is: south-west and a little above, so that the whole
    flight is seen."""
    centre_m = (extent.low_m + extent.high_m) / 2
    eye_m = centre_m + size_m(extent) * _FROM_CENTRE
    share = _FLAT_SHIFT * (1.0 - float(extent.high_m[2] - extent.low_m[2]) / size_m(extent))
    target_m = centre_m - np.array([0.0, 0.0, share * size_m(extent)])
    return target_m, target_m + (1.0 - share) * (eye_m - centre_m)


_FLIGHT, _EVENTS = "3D!flight", "RosOut!events"
_FIELD_OF_VIEW_DEG = 50.0
_FARTHER = 1.45
"""Distance of the camera, as a multiple of that in a view with a wider field."""
_AXIS_SHARE, _PATH_SHARE = 0.1, 0.003
"""Length of the vehicle's axes and width of the path as shares of the scene's size."""
_PATH_RGBA = ["#{:02x}{:02x}{:02x}ff".format(*PATH_RGB)] * 2
"""Colours of the path's start and end."""


def write_foxglove_layout(run: RecordedRun, path: Path) -> None:
    """Write a layout for a recording's file `.ros2.mcap`.

    Raises:
        InputError: the path cannot be written.
        RunError: writing failed.
    """
    with whole_file(path) as file:
        file.write(json.dumps(_layout(run), indent=1).encode())


def _layout(run: RecordedRun) -> dict[str, Any]:
    measured = run.measurement
    panels = {
        f"Plot!{name}": _plot(title, _curves(name, measured.beam_count), has_legend=number == 0)
        for number, (name, title) in enumerate(plots(run.keeps_time).items())
    }
    first, *others = panels  # the first is twice as high: its legend names all beams
    curves = _split("column", first, _one_above_the_other(others), 200.0 / (len(panels) + 1))
    panels[_EVENTS] = {"topicToRender": "/events", "minLogLevel": 1, "searchTerms": []}
    if run.is_flight:
        panels[_FLIGHT] = _flight(measured, extent_of(measured))
        left: Any = _split("column", _FLIGHT, _EVENTS, 80.0)
    else:
        left = _EVENTS
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split("row", left, curves, 60.0),
    }


def _flight(measured: Measurement, extent: Extent) -> dict[str, Any]:
    speed_mps = measured.closing_speed_mps[measured.range_valid & measured.speed_valid]
    limits = {} if speed_mps.size == 0 else {"minValue": speed_mps.min(), "maxValue": speed_mps.max()}
    points = {
        "visible": True,
        "pointSize": 5,
        "decayTime": POINTS_S,
        "colorMode": "colormap",
        "colorMap": "turbo",
        "colorField": "closing_speed_mps",
        **limits,
    }
    axis_m = _AXIS_SHARE * size_m(extent)
    return {
        "cameraState": _camera(extent),
        "followMode": "follow-none",
        "followTf": "site",
        "scene": {
            "backgroundColor": "#{:02x}{:02x}{:02x}".format(*DARK_RGB),
            # Studio and Lichtblick take a scale of axes of 1 m, later releases the size.
            "transforms": {"axisScale": axis_m, "axisSize": axis_m, "showLabel": False, "lineWidth": 0},
        },
        "transforms": {"frame:body": {"visible": True}, "frame:site": {"visible": False}},
        "topics": {
            "/ground": {"visible": True},
            "/path": {
                "visible": True,
                "type": "line",
                "lineWidth": _PATH_SHARE * size_m(extent),
                "gradient": _PATH_RGBA,
            },
            "/beams": {"visible": True},
            "/points": points,
        },
        "layers": {},
    }


def _camera(extent: Extent) -> dict[str, Any]:
    """The camera, in polar coordinates about its target; azimuth 0 is south of it, 90 degrees west."""
    target_m, eye_m = target_and_eye_m(extent)
    offset_m: FloatArray = _FARTHER * (eye_m - target_m)
    distance_m = float(np.linalg.norm(offset_m))
    return {
        "perspective": True,
        "distance": distance_m,
        "phi": math.degrees(math.acos(offset_m[2] / distance_m)),
        "thetaOffset": math.degrees(math.atan2(-offset_m[0], -offset_m[1])),
        "target": [0, 0, 0],
        "targetOffset": target_m.tolist(),
        "targetOrientation": [0, 0, 0, 1],
        "fovy": _FIELD_OF_VIEW_DEG,
        "near": 1e-3 * distance_m,
        "far": 10 * distance_m,
    }


def _curves(name: str, beam_count: int) -> list[dict[str, Any]]:
    labels = {f"/beam_{beam}/{name}.data": f"beam {beam}" for beam in range(beam_count)}
    if name == LATENESS:
        labels = {f"/lateness/{name}.data": "packets"}
    alike = {"enabled": True, "timestampMethod": "receiveTime"}
    return [
        {"value": value, "label": label, "color": beam_colour(number), **alike}
        for number, (value, label) in enumerate(labels.items())
    ]


def _plot(title: str, curves: list[dict[str, Any]], *, has_legend: bool) -> dict[str, Any]:
    return {
        "foxglovePanelTitle": title,
        "paths": curves,
        "xAxisVal": "timestamp",
        "isSynced": True,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": has_legend,
        "legendDisplay": "floating",
        "floatingLegendPosition": "top-right",
        "showPlotValuesInLegend": False,
        "sidebarDimension": 240,
    }


def _one_above_the_other(panels: list[str]) -> Any:
    first, *others = panels
    return _split("column", first, _one_above_the_other(others), 100.0 / len(panels)) if others else first


def _split(direction: str, first: Any, second: Any, percentage: float) -> dict[str, Any]:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}
