"""Write a recording as a file for the Rerun viewer."""

from __future__ import annotations

from pathlib import Path

from lidar_emu.errors import RunError
from lidar_emu.report.ground_below import extent_of
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.viewer.ground_mesh import scene_of
from lidar_emu.viewer.rerun_layout import layout
from lidar_emu.viewer.scene_log import log_scene
from lidar_emu.viewer.value_log import log_events, log_values


def write_rerun(run: RecordedRun, path: Path) -> list[str]:
    """Write a `.rrd` file; returns what is missing in it, with the reasons.

    Raises:
        RunError: writing failed.
    """
    import rerun as rr

    notes: list[str] = []
    stream = rr.RecordingStream(
        "lidar-emu", recording_id=f"{run.name} {run.recording.started_utc.isoformat()}"
    )
    try:
        extent = extent_of(run.measurement) if run.is_flight else None
        stream.save(path, default_blueprint=layout(extent, run.keeps_time))
        if extent is not None:
            log_scene(stream, run.measurement, scene_of(run, notes), extent)
        else:
            notes.append("no flight to show: a bench pattern has no positions")
        log_values(stream, run)
        log_events(stream, run)
        stream.flush()
    except (OSError, RuntimeError) as error:
        raise RunError(f"{path}: could not be written: {error}") from None
    finally:
        stream.disconnect()
    return notes
