"""Files of a recorded flight for viewers, by the ending of their names."""

from __future__ import annotations

from pathlib import Path

from lidar_emu.files import check_destination, check_extra
from lidar_emu.report.recorded_run import RecordedRun

_NEEDS = {
    ".foxglove.json": None,
    ".ros2.mcap": ("rosbags", "ros"),
}
"""Package that writing takes, and its extra."""
ENDINGS = tuple(_NEEDS)


def ending_of(path: Path) -> str | None:
    """The ending that names a kind of file; None: another file."""
    return next((ending for ending in ENDINGS if path.name.endswith(ending)), None)


def check_flight_file(path: Path, ending: str, option: str) -> None:
    """Check the path of a file before a long recording is read.

    Raises:
        InputError: the folder is missing or read-only, or an extra is not installed.
    """
    if (needed := _NEEDS[ending]) is not None:
        check_extra(str(path), ending, *needed)
    check_destination(path, option)


def write_flight_file(run: RecordedRun, path: Path, ending: str) -> list[str]:
    """Write a file; returns lines that state what it holds, and what is missing.

    Raises:
        InputError: the path cannot be written.
        RunError: writing failed.
    """
    if ending == ".ros2.mcap":
        from lidar_emu.viewer.message_stream import write_ros2

        shots = f"{path}: {len(run.measurement)} shots of {run.measurement.beam_count} beams"
        return [shots, *write_ros2(run, path)]
    from lidar_emu.viewer.layouts import write_foxglove_layout

    write_foxglove_layout(run, path)
    return [f"{path}: a layout for {run.measurement.beam_count} beams"]
