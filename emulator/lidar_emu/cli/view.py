"""`lidar-emu view`: a recording in the Rerun viewer."""

from __future__ import annotations

import os
import subprocess
import tempfile
from pathlib import Path

import click

from lidar_emu.cli.output import print_line
from lidar_emu.cli.progress import busy
from lidar_emu.errors import InputError, RunError
from lidar_emu.files import check_destination, check_extra, check_keeps

_SUFFIX = ".rrd"
_LOCAL = "127.0.0.1"


@click.command(short_help="Show a recording in three dimensions, with plots and events.")
@click.argument("file")
@click.option("--save", metavar="FILE.rrd", help="Write a file for the viewer, and show nothing.")
@click.option(
    "--web", is_flag=True, help="Show it in a browser, at an address of this machine alone, until Ctrl-C."
)
@click.option(
    "--web-port",
    type=click.IntRange(1, 65534),
    default=9090,
    show_default=True,
    help="Port of --web; the next one serves the data.",
)
def view(file: str, save: str | None, web: bool, web_port: int) -> None:
    """Show FILE, a recording of `lidar-emu run --record`, in the Rerun viewer.

    Ground, vehicle with its attitude, beams coloured by range and points by speed; ranges, speeds, their errors and
    lateness over time; lost beams, faults, commands and events. It needs the extra `view`.

    \b
    lidar-emu view flight.mcap                         a window
    lidar-emu view flight.mcap --web                   in a browser
    lidar-emu view flight.mcap --save flight.rrd       then: rerun flight.rrd
    """
    check_extra("view", "the viewer", "rerun", "view")
    if save is not None and web:
        raise InputError("--save", None, save, "allowed: without --web")
    if save is not None:
        path = Path(save)
        if path.suffix != _SUFFIX:
            raise InputError("--save", None, save, f"allowed: a file {_SUFFIX}")
        check_keeps(Path(file), path, "--save")
        check_destination(path, "--save")
        _write(Path(file), path)
        print_line(f"{path}: {path.stat().st_size / 1e6:.1f} MB")
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{Path(file).stem}{_SUFFIX}"
        _write(Path(file), path)
        _show(path, web_port if web else None)


def _write(file: Path, path: Path) -> None:
    from lidar_emu.recording.read import read_recording
    from lidar_emu.report.recorded_run import read_recorded_run
    from lidar_emu.viewer.rerun_file import write_rerun

    with busy(f"reading {file}"):
        notes = write_rerun(read_recorded_run(read_recording(file)), path)
    for note in notes:
        print_line(note)


def _show(path: Path, web_port: int | None) -> None:
    """Start the viewer, without its usage statistics, and wait for its end."""
    import rerun_cli

    options = ["--bind", _LOCAL]
    if web_port is not None:
        options += ["--serve-web", "--web-viewer-port", str(web_port), "--port", str(web_port + 1)]
        data = f"rerun%2Bhttp://{_LOCAL}:{web_port + 1}/proxy"
        print_line(f"http://{_LOCAL}:{web_port}?url={data}, until Ctrl-C")
    environment = {"RUST_LOG": "error", **os.environ, "RERUN_ANALYTICS": "0"}
    # The program itself: SIGTERM would end the package's Python wrapper and leave the viewer running.
    viewer = [str(Path(rerun_cli.__file__).parent / "rerun"), str(path), *options]
    with subprocess.Popen(viewer, env=environment) as process:
        try:
            status = process.wait()
        except KeyboardInterrupt:
            process.terminate()
            return
    if status > 0:
        raise RunError(f"the viewer has ended with exit code {status}")
