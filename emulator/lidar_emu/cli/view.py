"""`lidar-emu view`: a recording in the Rerun viewer, or over a WebSocket for Foxglove; also one being written."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.terminal import busy, print_line
from lidar_emu.errors import Finding, InputError, RunError
from lidar_emu.files import check_destination, check_extra, check_keeps
from lidar_emu.runtime.signals import until_signal
from lidar_emu.viewer.addresses import FOXGLOVE_PORT, WEB_PORT, check_display, web_address, web_socket_address

if TYPE_CHECKING:
    from lidar_emu.recording.read import Recording

NICENESS = 10
"""How far a viewer gives way to the run."""


@click.command(short_help="Show a recording in three dimensions, with plots and events; also during its run.")
@click.argument("file")
@click.option("--save", metavar="FILE.rrd", help="Write a file for the viewer, and show nothing.")
@click.option(
    "--web", is_flag=True, help="Show it in a browser, at an address of this machine alone, until Ctrl-C."
)
@click.option(
    "--foxglove",
    is_flag=True,
    help="Send a recording that is being written to Foxglove, over a WebSocket of this machine alone.",
)
@click.option(
    "--port",
    type=click.IntRange(1, 65534),
    help="Port of --web (9090; the next one serves the data) or of --foxglove (8765).",
)
def view(file: str, save: str | None, web: bool, foxglove: bool, port: int | None) -> None:
    """Show FILE, a recording of `lidar-emu run --record`, in the Rerun viewer.

    Ground, vehicle with its attitude, beams coloured by range and points by speed; ranges, speeds, their errors and
    lateness over time; lost beams, faults, commands and events. It needs the extra `view`, Foxglove the extra `live`.

    A recording that is still being written is shown as it grows. The run notices nothing of its viewers.

    \b
    lidar-emu view flight.mcap                         a window
    lidar-emu view flight.mcap --web                   in a browser
    lidar-emu view flight.mcap --save flight.rrd       then: rerun flight.rrd
    lidar-emu view flight.mcap --foxglove              then in Foxglove: Open connection, ws://127.0.0.1:8765
    """
    given = [name for name, value in (("--save", save), ("--web", web), ("--foxglove", foxglove)) if value]
    if len(given) > 1:
        raise InputError(given[1], None, Finding(f"with {given[0]}"), "pass one of them")
    if port is not None and not (web or foxglove):
        raise InputError("--port", None, port, "needs --web or --foxglove")
    if foxglove:
        check_extra("view", "Foxglove", "foxglove", "live")
        _serve(Path(file), port)
        return
    if save is None and not web:
        check_display("view", "pass --web, for a browser, or --save FILE.rrd")
    check_extra("view", "the viewer", "rerun", "view")
    if save is not None:
        _save(Path(file), Path(save))
    else:
        _show(Path(file), web, port)


def _save(file: Path, path: Path) -> None:
    check_keeps(file, path, "--save")
    check_destination(path, "--save", [".rrd"])
    from lidar_emu.recording.read import read_recording
    from lidar_emu.report.recorded_run import read_recorded_run
    from lidar_emu.viewer.rerun_viewer import write_rerun

    with busy(f"reading {file}"):
        notes = write_rerun(read_recorded_run(read_recording(file)), path)
    for note in notes:
        print_line(note)
    print_line(f"{path}: {path.stat().st_size / 1e6:.1f} MB")


def _show(file: Path, web: bool, port: int | None) -> None:
    from lidar_emu.viewer.flight_parts import follow
    from lidar_emu.viewer.rerun_viewer import RerunLog, rerun_viewer

    recording = _open(file)
    web_port = (port or WEB_PORT) if web else None
    with until_signal(), rerun_viewer(web_port) as (viewer, url):
        if web_port is not None:
            print_line(f"{web_address(web_port)}, until Ctrl-C")
        log = RerunLog(recording, is_running=not recording.is_whole)
        log.stream.connect_grpc(url)
        for part in follow(recording, print_line):
            if part is not None:
                log.show(part)
            if viewer.poll() is not None:
                break
        if (status := viewer.wait()) > 0:
            raise RunError(f"the viewer has ended with exit code {status}")


def _serve(file: Path, port: int | None) -> None:
    from lidar_emu.viewer.flight_parts import follow, polls
    from lidar_emu.viewer.foxglove_server import FoxgloveServer

    recording = _open(file)
    if recording.is_whole:
        remedy = f"convert it: lidar-emu report {file} --out {file.stem}.ros2.mcap"
        raise InputError("--foxglove", None, Finding("a complete recording"), remedy)
    port = port or FOXGLOVE_PORT
    with until_signal(), FoxgloveServer(recording.scenario.name, port) as server:
        for part in follow(recording, print_line):
            if part is not None:
                server.show(part)
                if not server.is_listening:
                    server.listen()
                    print_line(f"{web_socket_address(port)}, until Ctrl-C")
            server.send_again()
        for _ in polls():
            server.send_again()


def _open(file: Path) -> Recording:
    """Open a recording; while it is being written, its run comes first."""
    from lidar_emu.recording.read import read_recording

    recording = read_recording(file)
    if not recording.is_whole and hasattr(os, "nice"):
        os.nice(max(0, NICENESS - os.nice(0)))
    return recording
