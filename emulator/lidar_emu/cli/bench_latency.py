"""`lidar-emu bench realtime` and `bench response`: lateness and latency here, compared with a control process."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lidar_emu.cli.options import as_number, as_whole, check_plot, plot_option
from lidar_emu.cli.terminal import print_line, print_note, show_step
from lidar_emu.errors import InputError
from lidar_emu.transports.spec import DEFAULT_BAUD, parse_port

if TYPE_CHECKING:
    from rich.table import Table

    from lidar_emu.bench.realtime import RealtimeReport


_OPTIONS: dict[str | None, str] = {
    "timing.rate_hz": "--rate",
    "duration_s": "--duration",
    "instrument.optics.beamlets": "--beamlets",
}

_FIGURES = {"p50_ns": "p50", "p99_ns": "p99", "p99_9_ns": "p99.9", "max_ns": "max"}
_STAGES = {"wake_up": "woken up", "due_to_written": "written", "due_to_received": "received"}
_BAR_COLUMNS = 24
_COLUMN = 8 + 1 + _BAR_COLUMNS + 2


@click.command(short_help="Lateness of packets on this machine, compared with a control process.")
@click.option("--rate", default="1111", show_default=True, metavar="HZ", help="Shots per second.")
@click.option("--duration", default="10", show_default=True, metavar="S", help="Length of the flight.")
@click.option("--beamlets", default="61", show_default=True, metavar="N", help="Per beam, of four beams.")
@click.option("--record", is_flag=True, help="Record the flight too, into a temporary file.")
@click.option(
    "--port", metavar="PORT", help="Write to this port instead of a pty; `check` has its far end, too."
)
@click.option("--baud", type=int, metavar="N", help=f"Serial bit rate of --port.  [default: {DEFAULT_BAUD}]")
@plot_option("the distribution of lateness, and the p99 of each second")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def realtime(
    rate: str,
    duration: str,
    beamlets: str,
    record: bool,
    port: str | None,
    baud: int | None,
    plot: tuple[str, ...],
    as_json: bool,
) -> None:
    """Fly at level spectral over a pty that represents a serial line of 3 Mbit/s, and measure every packet's lateness.

    At the same time a control process, at the same priority, writes the same number of bytes at the same instants to
    another pty and does nothing else: its lateness is the machine's. The ratio divides its median by the emulator's.
    docs/timing.md explains the figures, and how to improve a machine.
    Ctrl-C ends the flight and prints the measurements so far.

    \b
    lidar-emu bench realtime
    lidar-emu bench realtime --rate 100 --duration 600 --record --plot lateness.png
    lidar-emu bench realtime --rate 20 --port /dev/ttyUSB0 --baud 921600
    lidar-emu bench realtime --json
    """
    check_plot(plot)
    spec = parse_port(port, baud)
    rate_hz, duration_s = as_number("--rate", rate), as_number("--duration", duration)
    count = as_whole("--beamlets", beamlets)
    from lidar_emu.bench.realtime import RealtimeOptions, measure_realtime, realtime_document

    with named_by_option():
        given = {} if port is None else {"port": spec}
        report = measure_realtime(RealtimeOptions(rate_hz, duration_s, count, record, **given), show_step)
    show_step("")
    for path in plot:
        _plot(report, Path(path))
    document = realtime_document(report)
    if as_json:
        print_line(json.dumps(document, indent=2))
    else:
        print_realtime(document)
    control, emulator = (document[side]["due_to_written"] for side in ("control", "emulator"))
    print_ratio(control, emulator, "median lateness of the control to ours")


def print_ratio(control: dict[str, int | None], emulator: dict[str, int | None], of: str) -> None:
    """Print the ratio of medians to standard error, if both were measured."""
    ours_ns, theirs_ns = emulator["p50_ns"], control["p50_ns"]
    if ours_ns and theirs_ns:
        print_note(f"ratio: {theirs_ns / ours_ns:.3g} ({of})")


def _plot(report: RealtimeReport, path: Path) -> None:
    from lidar_emu.report.run_figures import LatenessCurve, plot_lateness

    options, at_s = report.options, [window.at_s for window in report.windows]
    ours_ns = [window.p99_ns for window in report.windows]
    theirs_ns = [window.control_p99_ns for window in report.windows]
    curves = [
        LatenessCurve("emulator", report.emulator.due_to_written_ns(), at_s, ours_ns),
        LatenessCurve("control", report.control.due_to_written_ns(), at_s, theirs_ns),
    ]
    title = f"{options.rate_hz:g} shots/s, four beams of {options.beamlets} beamlets, level spectral"
    plot_lateness(curves, title, path)
    print_note(f"{path}: {title}")


@contextmanager
def named_by_option() -> Iterator[None]:
    """Name the command-line option in an error about the scenario key that it sets."""
    try:
        yield
    except InputError as error:
        raise InputError(_OPTIONS.get(error.key, error.where), None, error.value, error.remedy) from None


def print_realtime(document: dict[str, Any]) -> None:
    """Print figures, seconds, histogram, and what the machine granted."""
    from lidar_emu.cli.plain_console import PlainConsole

    console = PlainConsole()
    console.print_lines(
        f"{document['rate_hz']:g} shots/s of {document['packet_bytes']} bytes, "
        f"four beams of {document['beamlets']} beamlets"
        f"{', recorded' if document['recording'] else ''}"
    )
    table = figures_table("us after they were due")
    for side in ("emulator", "control"):
        for stage, name in _STAGES.items():
            table.add_row(f"{side}, {name}", *figure_cells(document[side][stage]))
        table.add_section()
    console.print(table)
    histogram = document["histogram"]
    lines = histogram_lines(
        {side: histogram[side] for side in ("emulator", "control")}, histogram["edges_ns"]
    )
    console.print_lines(*_comparison(document), *_machine(document), "", *lines)
    if document["interrupted"]:
        console.print("the flight was interrupted")


def figures_table(first_heading: str) -> Table:
    """An empty table with a column for each quantile."""
    from lidar_emu.cli.plain_console import plain_table

    table = plain_table(first_heading, "shots", *_FIGURES.values(), texts=1)
    table.padding = (0, 1)
    return table


def figure_cells(figures: dict[str, int | None]) -> list[str]:
    """The cells of a row: count and quantiles in microseconds."""
    return [str(figures["count"]), *(_us(figures[name]) for name in _FIGURES)]


def _us(nanoseconds: float | None) -> str:
    return "-" if nanoseconds is None else f"{nanoseconds / 1e3:.0f}"


def _comparison(document: dict[str, Any]) -> list[str]:
    windows, emulator, control = document["windows"], document["emulator"], document["control"]
    return [
        f"seconds    {windows['count']}: p99 due to written is {_us(windows['median_excess_p99_ns'])} us above the "
        "control's (median over the seconds)",
        f"late       {emulator['late']} of {emulator['due']} (control {control['late']}), "
        f"{windows['late_where_control_had_none']} of them in seconds in which the control had none; "
        f"{emulator['dropped']} dropped",
    ]


def _machine(document: dict[str, Any]) -> list[str]:
    steal = (
        "not available" if document["steal_ticks"] is None else f"{document['steal_ticks']} ticks of 10 ms"
    )
    machine = document["machine"]
    return [
        f"machine    {machine['cores']} cores, Linux {machine['kernel']}; stolen by the host: {steal}",
        *privilege_lines(document),
    ]


def privilege_lines(document: dict[str, Any]) -> list[str]:
    """What the machine granted, and how to get the rest."""
    return [
        f"granted    {', '.join(document['granted']).replace('_', ' ') or 'nothing'}",
        *(
            f"{'':10} no {name.replace('_', ' ')}; to get it: {how}"
            for name, how in document["missing"].items()
        ),
    ]


def histogram_lines(sides: dict[str, list[int]], edges_ns: list[int]) -> list[str]:
    """A histogram of lateness for each side, by its name."""
    most = max((2, *(count for counts in sides.values() for count in counts)))
    heading = "".join(f"{name:<{_COLUMN}}" for name in sides).rstrip()
    lines = [f"{'due to written':>16}  {heading}"]
    for edge, *counts in zip(edges_ns, *sides.values(), strict=False):
        cells = "".join(f"{count:>8} {_bar(count, most):<{_BAR_COLUMNS + 2}}" for count in counts)
        lines.append(f"{'from ' + _us(edge) + ' us':>16}{cells}".rstrip())
    return lines


def _bar(count: int, most: int) -> str:
    return "#" * math.ceil(_BAR_COLUMNS * math.log(count + 1) / math.log(most + 1)) if count else ""


@click.command(short_help="Latency from a simulator's truth to the wire, compared with a control process.")
@click.option("--rate", default="100", show_default=True, metavar="HZ", help="Shots and truths per second.")
@click.option("--duration", default="10", show_default=True, metavar="S", help="Length of the flight.")
@click.option("--beamlets", default="61", show_default=True, metavar="N", help="Per beam, of four beams.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def response(rate: str, duration: str, beamlets: str, as_json: bool) -> None:
    """Fly on a simulator's live truth at level spectral, each shot just in time, over a pty that represents 3 Mbit/s.

    The latency runs from the instant at which the simulator sends its datagram until the packet's last byte is written.
    Half a period later the simulator sends the same to a control process, which writes as many bytes to another pty.
    The ratio divides the control's median latency by the emulator's: an emulator that takes no time would reach 1.

    \b
    lidar-emu bench response
    lidar-emu bench response --rate 20 --duration 60 --json
    """
    rate_hz, duration_s = as_number("--rate", rate), as_number("--duration", duration)
    count = as_whole("--beamlets", beamlets)
    from lidar_emu.bench.realtime_statistics import figures
    from lidar_emu.bench.response import measure_response

    with named_by_option():
        report = measure_response(rate_hz, duration_s, count, show_step)
    show_step("")
    document: dict[str, Any] = {
        "rate_hz": rate_hz,
        "beamlets": count,
        "shots": report.summary["shots"],
        "stale_shots": report.summary["truth"]["stale_shots"],
        "truth_age": report.summary["truth"]["age"],
        "emulator": figures(report.emulator_ns),
        "control": figures(report.control_ns),
        "steal_ticks": report.summary["steal_ticks"],
    }
    if as_json:
        print_line(json.dumps(document, indent=2))
    else:
        _print(document)
    print_ratio(document["control"], document["emulator"], "median latency of the control to ours")


def _print(document: dict[str, Any]) -> None:
    from lidar_emu.cli.plain_console import PlainConsole

    console = PlainConsole()
    table = figures_table("us from truth sent to last byte written")
    for side in ("emulator", "control"):
        table.add_row(side, *figure_cells(document[side]))
    console.print(table)
    shots = document["shots"]
    console.print_lines(
        f"{document['rate_hz']:g} shots/s, four beams of {document['beamlets']} beamlets; {shots['sent']} sent, "
        f"{shots['late']} late; host steal {document['steal_ticks']} ticks"
    )
