"""`lidar-emu report`: a recording as a table, as files for other tools, figures and an HTML page."""

from __future__ import annotations

import gc
import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.options import as_instant
from lidar_emu.cli.terminal import PREPARING, busy, print_line, print_lines
from lidar_emu.errors import InputError
from lidar_emu.files import check_destination, check_extra, check_keeps, made_folder

if TYPE_CHECKING:
    from lidar_emu.report.evidence import Evidence
    from lidar_emu.report.recorded_run import RecordedRun

_FOXGLOVE, _ROS2 = ".foxglove.json", ".ros2.mcap"
"""Endings of files for viewers."""


@click.command(short_help="Summarise a recording: table, files for other tools, an HTML page with figures.")
@click.argument("file")
@click.option("--out", metavar="FILE", multiple=True,
              help="Write measurements (.csv, .parquet, .npz), points (.ply), a flight for Foxglove, "
                   "RViz and PlotJuggler (.ros2.mcap), a layout for Foxglove (.foxglove.json), "
                   "or link traffic (.pcap, .ccsds; for CAN .log in candump's format, .asc, .blf). "
                   "Repeatable.")  # fmt: skip
@click.option("--html", metavar="FILE.html", help="Write one HTML page with everything; it needs no network.")
@click.option("--evidence", metavar="FILE", multiple=True,
              help="Show results in the page's chapter for the review: of fit, budget or bench accuracy with "
                   "--json, or a campaign's requirements.xml or sensitivity.csv. Repeatable.")  # fmt: skip
@click.option("--figures", metavar="DIR", help="Write the page's figures, each as PNG and PDF.")
@click.option("--spectra-at", metavar="S", multiple=True,
              help="Plot the spectra of the valid measurement nearest to this instant (repeatable).")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print the table as JSON, nothing else.")
def report(
    file: str,
    out: tuple[str, ...],
    html: str | None,
    evidence: tuple[str, ...],
    figures: str | None,
    spectra_at: tuple[str, ...],
    as_json: bool,
) -> None:
    """Summarise FILE, a recording of `lidar-emu run --record`, complete or truncated.

    \b
    lidar-emu report flight.mcap
    lidar-emu report flight.mcap --out flight.parquet --out flight.pcap
    lidar-emu report flight.mcap --out flight.ros2.mcap --out flight.foxglove.json
    lidar-emu report flight.mcap --html flight.html --figures pictures
    lidar-emu report flight.mcap --html flight.html --spectra-at 12.5
    lidar-emu report flight.mcap --html flight.html --evidence fit.json --evidence results/requirements.xml
    """
    outputs = [Path(name) for name in out]
    for path in outputs:
        check_keeps(Path(file), path, "--out")
        _check_output(path)
    at_s = [as_instant("--spectra-at", text) for text in spectra_at]
    page = None if html is None else Path(html)
    if page is not None:
        check_keeps(Path(file), page, "--html")
        check_destination(page, "--html", [".html", ".htm"])
    folder = None if figures is None else made_folder("--figures", figures)
    if at_s and page is None and folder is None:
        raise InputError("--spectra-at", None, spectra_at[0], "needs --html or --figures")
    if evidence and page is None:
        raise InputError("--evidence", None, evidence[0], "needs --html")
    if page is not None or folder is not None:
        check_extra("report", "figures", "matplotlib", "plots")
    from lidar_emu.cli.run_lines import contents_lines
    from lidar_emu.measurement import COLUMNS
    from lidar_emu.recording.read import read_recording
    from lidar_emu.report.evidence import read_evidence
    from lidar_emu.report.exports import SUFFIXES
    from lidar_emu.report.recorded_run import REPORTED, read_recorded_run

    found = [read_evidence(Path(name)) for name in evidence]
    has_tables = any(path.suffix in SUFFIXES for path in outputs)
    with busy(f"reading {file}"):
        flown = read_recorded_run(read_recording(file), COLUMNS if has_tables else REPORTED)
        contents = flown.contents()
    lines = contents_lines(contents)
    if as_json:
        print_line(json.dumps(contents, indent=2))
    else:
        print_lines(lines)
    written = [line for path in outputs for line in _write(flown, path)]
    if page is not None or folder is not None:
        written += _draw(flown, lines, page, folder, at_s, found)
    if not as_json and written:
        print_line("\n".join(written))


def _write(flown: RecordedRun, path: Path) -> list[str]:
    from lidar_emu.report.exports import SUFFIXES, export

    shots = f"{path}: {len(flown.measurement)} shots of {flown.measurement.beam_count} beams"
    if path.suffix in SUFFIXES:
        export([flown.measurement], path)
        return [shots]
    if path.name.endswith(_ROS2):
        from lidar_emu.viewer.ros2_messages import write_ros2

        return [shots, *write_ros2(flown, path)]
    if path.name.endswith(_FOXGLOVE):
        from lidar_emu.viewer.layouts import write_foxglove_layout

        write_foxglove_layout(flown, path)
        return [f"{path}: a layout for {flown.measurement.beam_count} beams"]
    from lidar_emu.recording.traffic import read_traffic, write_wire_file

    return [write_wire_file(read_traffic(flown.recording.path, as_sent=True), path)]


def _draw(
    flown: RecordedRun,
    lines: list[str],
    page: Path | None,
    folder: Path | None,
    at_s: list[float],
    evidence: list[Evidence],
) -> list[str]:
    from lidar_emu.report.figures import Figures, check_instants
    from lidar_emu.report.html_parts import figure_element
    from lidar_emu.report.page import write_page
    from lidar_emu.report.plot_style import write_drawing

    check_instants(flown, at_s)
    elements, pictures = [], []
    with busy(PREPARING):
        figures = Figures(flown, at_s)
        for drawing in figures:
            if page is not None:
                elements.append(figure_element(drawing))
            if folder is not None:
                for suffix in ("png", "pdf"):
                    pictures.append(f"{drawing.name}.{suffix}")
                    write_drawing(drawing, folder / pictures[-1])
            # Before the next one is drawn: its parts refer to one another, and may hold 100 MB.
            del drawing
            gc.collect()
        if page is not None:
            write_page(page, flown, lines, elements, figures.notes, figures.plan, evidence)
    written = []
    if page is not None:
        written.append(f"{page}: {len(elements)} figures, {page.stat().st_size / 1e6:.2f} MB")
    if folder is not None:
        written.append(f"{folder}: {', '.join(pictures)}")
    return written + figures.notes


def _check_output(path: Path) -> None:
    from lidar_emu.recording.traffic import WIRE_SUFFIXES, check_wire_file
    from lidar_emu.report.exports import SUFFIXES, check_export_path

    if path.suffix in SUFFIXES:
        check_export_path(path)
    elif path.suffix.lower() in WIRE_SUFFIXES:
        check_wire_file(path, "--out")
    elif path.name.endswith((_FOXGLOVE, _ROS2)):
        if path.name.endswith(_ROS2):
            check_extra(str(path), _ROS2, "rosbags", "ros")
        check_destination(path, "--out")
    else:
        remedy = f"must be a file {', '.join((*SUFFIXES, _FOXGLOVE, _ROS2, *WIRE_SUFFIXES))}"
        raise InputError("--out", None, str(path), remedy)
