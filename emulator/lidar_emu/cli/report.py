"""`lidar-emu report`: a recording as a table, as files for other tools, figures and an HTML page."""

from __future__ import annotations

import gc
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lidar_emu.cli.terminal import PREPARING, busy, print_line
from lidar_emu.errors import Finding, InputError
from lidar_emu.files import check_destination, check_extra, check_keeps

if TYPE_CHECKING:
    from lidar_emu.report.recorded_run import RecordedRun


@click.command(short_help="Summarise a recording: table, files for other tools, an HTML page with figures.")
@click.argument("file", required=False)
@click.option("--out", metavar="FILE", multiple=True,
              help="Write measurements (.csv, .parquet, .npz), points (.ply), a flight for Foxglove, "
                   "RViz and PlotJuggler (.ros2.mcap), a layout for Foxglove (.foxglove.json) or PlotJuggler "
                   "(.plotjuggler.xml), or link traffic (.pcap, .ccsds; for CAN .log in candump's format, .asc, .blf). "
                   "Repeatable.")  # fmt: skip
@click.option("--html", metavar="FILE", help="Write one HTML page with everything; it needs no network.")
@click.option("--figures", metavar="DIR", help="Write the page's figures as PNG.")
@click.option("--spectra-at", metavar="S", multiple=True,
              help="Plot the spectra of the valid measurement nearest to this instant (repeatable).")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print the table as JSON, nothing else.")
@click.option("--paper-figure", metavar="2|3|4|5",
              help="Instead of FILE: plot this figure of Budge et al. from its own scenario.")  # fmt: skip
def report(
    file: str | None,
    out: tuple[str, ...],
    html: str | None,
    figures: str | None,
    spectra_at: tuple[str, ...],
    as_json: bool,
    paper_figure: str | None,
) -> None:
    """Summarise FILE, a recording of `lidar-emu run --record`, complete or truncated.

    \b
    lidar-emu report flight.mcap
    lidar-emu report flight.mcap --out flight.parquet --out flight.pcap
    lidar-emu report flight.mcap --out flight.ros2.mcap --out flight.foxglove.json
    lidar-emu report flight.mcap --html flight.html --figures pictures
    lidar-emu report flight.mcap --html flight.html --spectra-at 12.5
    lidar-emu report --paper-figure 2
    lidar-emu report --paper-figure 5 --out slant.png
    """
    if paper_figure is not None:
        others: dict[str, Any] = {
            "FILE": file,
            "--html": html,
            "--figures": figures,
            "--json": as_json or None,
        }
        _draw_paper_figure(paper_figure, out, others)
        return
    if file is None:
        remedy = "name a recording, or --paper-figure 2, 3, 4 or 5"
        raise InputError("report", None, Finding("nothing to report"), remedy)
    outputs = [Path(name) for name in out]
    for path in outputs:
        check_keeps(Path(file), path, "--out")
        _check_output(path)
    at_s = [_instant(text) for text in spectra_at]
    page = None if html is None else _page_path(html, Path(file))
    folder = None if figures is None else _folder(figures)
    if at_s and page is None and folder is None:
        raise InputError("--spectra-at", None, spectra_at[0], "must be with --html or --figures")
    if page is not None or folder is not None:
        check_extra("report", "figures", "matplotlib", "plots")
    from lidar_emu.cli.summary_lines import contents_lines
    from lidar_emu.measurement import COLUMNS
    from lidar_emu.recording.read import read_recording
    from lidar_emu.report.exports import SUFFIXES
    from lidar_emu.report.recorded_run import REPORTED, read_recorded_run

    has_tables = any(path.suffix in SUFFIXES for path in outputs)
    with busy(f"reading {file}"):
        flown = read_recorded_run(read_recording(file), COLUMNS if has_tables else REPORTED)
        contents = flown.contents()
    lines = contents_lines(contents)
    print_line(json.dumps(contents, indent=2) if as_json else "\n".join(lines))
    written = [line for path in outputs for line in _write(flown, path)]
    if page is not None or folder is not None:
        written += _draw(flown, lines, page, folder, at_s)
    if not as_json and written:
        print_line("\n".join(written))


def _draw_paper_figure(figure: str, out: tuple[str, ...], others: dict[str, Any]) -> None:
    for name, value in (others | {"--out": out[1] if len(out) > 1 else None}).items():
        if value is not None:
            raise InputError(name, None, value, "allowed with --paper-figure: one --out FILE.png")
    if figure not in ("2", "3", "4", "5"):
        raise InputError("--paper-figure", None, figure, "must be 2, 3, 4 or 5")
    from lidar_emu.report.paper_figures import errors_of, plot_paper_figure

    path = Path(out[0] if out else f"paper_fig{figure}.png")
    with busy(PREPARING):
        errors = errors_of(plot_paper_figure(figure, path))
    print_line(f"{path}: figure {figure} of Budge et al., {errors.measured} of {errors.fired} beams measured")
    print_line(
        f"range error: mean {errors.range_mean_m:+.4f} m, standard deviation {errors.range_deviation_m:.4f} m"
    )
    print_line(
        f"speed error: mean {1e3 * errors.speed_mean_mps:+.4f} mm/s, "
        f"standard deviation {1e3 * errors.speed_deviation_mps:.4f} mm/s"
    )


def _write(flown: RecordedRun, path: Path) -> list[str]:
    from lidar_emu.report.exports import SUFFIXES, export
    from lidar_emu.viewer.flight_files import ending_of, write_flight_file

    if path.suffix in SUFFIXES:
        export([flown.measurement], path)
        return [f"{path}: {len(flown.measurement)} shots of {flown.measurement.beam_count} beams"]
    if (ending := ending_of(path)) is not None:
        return write_flight_file(flown, path, ending)
    from lidar_emu.recording.traffic import read_traffic
    from lidar_emu.report.wire_file import write_wire_file

    return [write_wire_file(read_traffic(flown.recording.path, as_sent=True), path)]


def _draw(
    flown: RecordedRun, lines: list[str], page: Path | None, folder: Path | None, at_s: list[float]
) -> list[str]:
    from lidar_emu.report.figures import Figures, check_instants
    from lidar_emu.report.page import figure_element, write_page
    from lidar_emu.report.plot_style import write_drawing as write_png

    check_instants(flown, at_s)
    elements, pictures = [], []
    with busy(PREPARING):
        figures = Figures(flown, at_s)
        for drawing in figures:
            if page is not None:
                elements.append(figure_element(drawing))
            if folder is not None:
                pictures.append(f"{drawing.name}.png")
                write_png(drawing, folder / pictures[-1])
            # Before the next one is drawn: its parts refer to one another, and may hold 100 MB.
            del drawing
            gc.collect()
        if page is not None:
            write_page(page, flown, lines, elements, figures.notes, figures.plan)
    written = []
    if page is not None:
        written.append(f"{page}: {len(elements)} figures, {page.stat().st_size / 1e6:.2f} MB")
    if folder is not None:
        written.append(f"{folder}: {', '.join(pictures)}")
    return written + figures.notes


def _check_output(path: Path) -> None:
    from lidar_emu.report.exports import SUFFIXES, check_export_path
    from lidar_emu.report.wire_file import WIRE_SUFFIXES, check_wire_file
    from lidar_emu.viewer.flight_files import ENDINGS, check_flight_file, ending_of

    if path.suffix in SUFFIXES:
        check_export_path(path)
    elif path.suffix.lower() in WIRE_SUFFIXES:
        check_wire_file(path, "--out")
    elif (ending := ending_of(path)) is not None:
        check_flight_file(path, ending, "--out")
    else:
        allowed = f"must be a file {', '.join((*SUFFIXES, *ENDINGS, *WIRE_SUFFIXES))}"
        raise InputError("--out", None, str(path), allowed)


def _page_path(name: str, recording: Path) -> Path:
    path = Path(name)
    check_keeps(recording, path, "--html")
    check_destination(path, "--html")
    if path.suffix not in (".html", ".htm"):
        raise InputError("--html", None, name, "must be a file .html")
    return path


def _folder(name: str) -> Path:
    path = Path(name)
    try:
        path.mkdir(exist_ok=True)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise InputError("--figures", None, name, f"must be a folder; {why}") from None
    return path


def _instant(text: str) -> float:
    try:
        instant_s = float(text)
    except ValueError:
        instant_s = math.nan
    if not math.isfinite(instant_s):
        raise InputError("--spectra-at", None, text, "must be a number of seconds")
    return instant_s
