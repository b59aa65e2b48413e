"""The Rerun viewer as a process: in a window, or in a browser on this machine."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lidar_emu.errors import RunError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.recording.read import Recording
from lidar_emu.report.beam_colours import beam_rgb
from lidar_emu.report.ground_survey import Extent
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.runtime.port.packets import DeliveryStatus
from lidar_emu.trajectory.profile import seconds
from lidar_emu.viewer.addresses import LOCAL, check_free, free_port
from lidar_emu.viewer.flight_parts import FlightPart, FlightParts, GroundMesh, Span, beam_values
from lidar_emu.viewer.layouts import (
    DARK_RGB,
    LATENESS,
    PATH_RGB,
    POINTS_S,
    plots,
    size_m,
    target_and_eye_m,
)

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

TIMELINE = "scenario_time"
_PATH_WIDTH, _BEAM_WIDTH, _POINT_WIDTH = 1.0, 1.2, 2.2
"""Radii in points of the screen, which are right at every distance."""
_BRIGHT_RGB = np.array([222.0, 218.0, 210.0])
"""Ground that faces the sun."""
_AXES_RGB = [(214, 69, 65), (46, 160, 67), (56, 108, 214)]


def layout(
    extent: Extent | None, time_span_s: Span | None, keeps_time: bool, is_running: bool
) -> rrb.Blueprint:
    """Arrange the views of a recording.

    Args:
        extent: the box to look at; None: there is no flight to show in three dimensions.
        time_span_s: what the plots show; None: what there is.
        keeps_time: packets had deadlines, so that there is a lateness.
        is_running: the views follow the newest values, instead of playing in a loop from the start.
    """
    import rerun.blueprint as rrb
    from rerun.encodings import TimeRange, TimeRangeBoundary

    axis = None
    if time_span_s is not None:
        begin, end = (TimeRangeBoundary.absolute(seconds=at_s) for at_s in time_span_s)
        axis = rrb.TimeAxis(view_range=TimeRange(start=begin, end=end))
    range_view, speed_view, *errors = (
        rrb.TimeSeriesView(
            origin=f"/{name}",
            name=title,
            # Errors fill their panel, and a beam has one colour in all panels.
            plot_legend=rrb.PlotLegend(corner="RightTop", visible="error" not in name),
            axis_x=axis,
        )
        for name, title in plots(keeps_time).items()
    )
    # One above the other they would be too low for a legend of four beams.
    curves = rrb.Vertical(range_view, speed_view, rrb.Tabs(*errors))
    columns = rrb.TextLogColumns(timeline_columns=[TIMELINE], text_log_columns=["LogLevel", "Body"])
    events = rrb.TextLogView(origin="/events", name="Events", columns=columns)
    panels = (
        rrb.TopPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(
            timeline=TIMELINE,
            state="collapsed",
            play_state="following" if is_running else "playing",
            loop_mode="off" if is_running else "all",
        ),
    )
    if extent is None:
        return rrb.Blueprint(rrb.Horizontal(curves, events), *panels)
    last = TimeRange(
        start=TimeRangeBoundary.cursor_relative(seconds=-POINTS_S),
        end=TimeRangeBoundary.cursor_relative(seconds=0.0),
    )
    target_m, eye_m = target_and_eye_m(extent)
    flight = rrb.Spatial3DView(
        origin="/site",
        name="Flight",
        background=DARK_RGB,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=eye_m, look_target=target_m, eye_up=(0.0, 0.0, 1.0)),
        overrides={"site/points": rrb.VisibleTimeRanges(rrb.VisibleTimeRange(TIMELINE, last))},
    )
    left = rrb.Vertical(flight, events, row_shares=[3, 1])
    return rrb.Blueprint(rrb.Horizontal(left, curves, column_shares=[2, 1]), *panels)


class RerunLog:
    """The parts of a recording, logged to a file or a viewer.

    Args:
        is_running: whether the viewer follows the newest values.
    """

    def __init__(self, recording: Recording, is_running: bool) -> None:
        os.environ.setdefault("RUST_LOG", "off")  # the library prints when a viewer is closed
        import rerun as rr

        name = f"{recording.scenario.name} {recording.started_utc.isoformat()}"
        self.stream: rr.RecordingStream = rr.RecordingStream("lidar-emu", recording_id=name)
        self._is_running = is_running
        self._has_layout = False

    def show(self, part: FlightPart) -> None:
        """Log a part."""
        import rerun as rr

        run, events = part.run, part.events
        if part.extent is not None or not self._has_layout:
            self.stream.send_blueprint(
                layout(part.extent, part.time_span_s, run.keeps_time, self._is_running)
            )
            self._log_styles(run)
            self._has_layout = True
        if run.is_flight:
            self._log_scene(part)
        self._log_values(run)
        columns = rr.TextLog.columns(
            text=[event.text for event in events], level=[event.level for event in events]
        )
        self._send("events", [event.time_ns * 1e-9 for event in events], columns)

    def _send(self, entity: str, time_s: FloatArray | Sequence[float], columns: Any) -> None:
        import rerun as rr

        if len(time_s):
            times = rr.TimeColumn(TIMELINE, duration=np.asarray(time_s))
            self.stream.send_columns(entity, [times], columns)

    def _log_scene(self, part: FlightPart) -> None:
        import rerun as rr

        stream, measured = self.stream, part.run.measurement
        if part.extent is not None:
            stream.log("site", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
            # The body frame's axes: x red, y green, z blue.
            axes = rr.Arrows3D(vectors=0.06 * size_m(part.extent) * np.eye(3), colors=_AXES_RGB)
            stream.log("site/vehicle", axes, static=True)
            for name, width in (("beams", _BEAM_WIDTH), ("path", _PATH_WIDTH)):
                lines = rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(width))
                stream.log(f"site/{name}", lines, static=True)
            points = rr.Points3D.from_fields(radii=rr.Radius.ui_points(_POINT_WIDTH))
            stream.log("site/points", points, static=True)
        if part.ground is not None:
            stream.log("site/ground", _mesh(part.ground), static=True)
        if part.path_site_m is not None:
            path = rr.LineStrips3D.from_fields(strips=[part.path_site_m], colors=[PATH_RGB])
            stream.log("site/path", path, static=True)
        time_s = seconds(measured.time_ns[:, 0])
        x_y_z_w = np.roll(measured.site_from_body, -1, axis=1)
        columns = rr.Transform3D.columns(translation=measured.position_site_m, quaternion=x_y_z_w)
        self._send("site/vehicle", time_s, columns)
        valid = measured.range_valid
        counts = valid.sum(axis=1)
        shot, beam = np.nonzero(valid)
        points_m = measured.point_site_m[valid]
        beams_m = np.stack([measured.position_site_m[shot], points_m], axis=1)
        rgb = np.array([beam_rgb(each) for each in range(measured.beam_count)], dtype=np.uint8)[beam]
        beams = rr.LineStrips3D.columns(strips=list(beams_m), colors=rgb)
        self._send("site/beams", time_s, beams.partition(counts))
        hits = rr.Points3D.columns(positions=points_m, colors=rgb)
        self._send("site/points", time_s, hits.partition(counts))

    def _log_values(self, run: RecordedRun) -> None:
        measured = run.measurement
        for name, values in beam_values(measured).items():
            for beam in range(measured.beam_count):
                of_beam = np.isfinite(values[:, beam])
                time_s = seconds(measured.time_ns[of_beam, beam])
                self._log_points(f"{name}/beam_{beam}", time_s, values[of_beam, beam])
        if run.keeps_time:
            sent = run.deliveries.status == DeliveryStatus.SENT
            due_s = seconds(run.deliveries.due_ns[sent])
            self._log_points(f"{LATENESS}/packets", due_s, run.lateness_us)

    def _log_points(self, entity: str, time_s: FloatArray, values: FloatArray) -> None:
        import rerun as rr

        self._send(entity, time_s, rr.Scalars.columns(scalars=values))

    def _log_styles(self, run: RecordedRun) -> None:
        import rerun as rr

        beams = [f"beam_{beam}" for beam in range(run.measurement.beam_count)]
        for name in plots(run.keeps_time):
            curves = ["packets"] if name == LATENESS else beams
            for number, curve in enumerate(curves):
                label, rgb = curve.replace("_", " "), beam_rgb(number)
                style = rr.SeriesPoints(markers="circle", marker_sizes=1.5, names=label, colors=[rgb])
                self.stream.log(f"{name}/{curve}", style, static=True)


def _mesh(ground: GroundMesh) -> rr.Mesh3D:
    import rerun as rr

    dark = np.array(DARK_RGB, dtype=np.float64)
    texture = dark + ground.texture[..., None] * (_BRIGHT_RGB - dark)
    return rr.Mesh3D(
        vertex_positions=ground.vertices_m,
        triangle_indices=ground.triangles,
        vertex_texcoords=ground.texture_points,
        albedo_texture=texture.astype(np.uint8),
    )


def write_rerun(run: RecordedRun, path: Path) -> list[str]:
    """Write a `.rrd` file; returns what is missing in it, with the reasons.

    Raises:
        RunError: writing failed.
    """
    notes: list[str] = []
    log = RerunLog(run.recording, is_running=False)
    try:
        log.stream.save(path)
        log.show(FlightParts(notes, is_running=False).part(run))
        log.stream.flush()
    except (OSError, RuntimeError) as error:
        raise RunError(f"{path}: could not be written: {error}") from None
    finally:
        log.stream.disconnect()
    return notes


_END_LIMIT_S = 2.0


@contextmanager
def rerun_viewer(web_port: int | None) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """Start the viewer, on this machine alone and without its usage statistics, and end it with the context.

    Yields the process, and the URL that takes data.

    Args:
        web_port: port of the page for a browser; None: a window.

    Raises:
        InputError: the port, or the next one, is in use.
    """
    import rerun_cli

    if web_port is None:
        port, web = free_port(), []  # another viewer at the usual port would take the data
    else:
        check_free("--port", web_port, web_port + 1)
        port, web = web_port + 1, ["--serve-web", "--web-viewer-port", str(web_port)]
    environment = {**os.environ, "RUST_LOG": "error", "RERUN_ANALYTICS": "0"}
    # The program itself: SIGTERM would end the package's Python wrapper and leave the viewer running.
    program = str(Path(rerun_cli.__file__).parent / "rerun")
    command = [program, "--bind", LOCAL, "--port", str(port), "--expect-data-soon", *web]
    with subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL) as process:
        try:
            yield process, f"rerun+http://{LOCAL}:{port}/proxy"
        finally:
            process.terminate()
            try:
                process.wait(_END_LIMIT_S)
            except subprocess.TimeoutExpired:  # it is stopped, or hangs
                process.kill()
