"""A recording for the Rerun viewer: as a file, or sent to a viewer while it is being written."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from lidar_emu.errors import RunError
from lidar_emu.recording.read import Recording
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.viewer.flight_parts import FlightPart, FlightParts
from lidar_emu.viewer.rerun_layout import layout
from lidar_emu.viewer.scene_log import log_scene
from lidar_emu.viewer.value_log import log_events, log_styles, log_values

if TYPE_CHECKING:
    import rerun as rr


class RerunLog:
    """The parts of a recording, logged to a file or a viewer.

    Args:
        recording: the recording.
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
        run = part.run
        if part.extent is not None or not self._has_layout:
            self.stream.send_blueprint(layout(part.extent, run.keeps_time, self._is_running))
            log_styles(self.stream, run.measurement.beam_count, run.keeps_time)
            self._has_layout = True
        if run.is_flight:
            log_scene(self.stream, part)
        log_values(self.stream, run)
        log_events(self.stream, part.events)


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
