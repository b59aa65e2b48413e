"""`lidar-emu bench realtime`: how late the emulator is on this machine, beside a control."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.options import as_number
from lidar_emu.errors import InputError

if TYPE_CHECKING:
    from lidar_emu.bench.realtime import RealtimeReport


_OPTIONS: dict[str | None, str] = {
    "timing.rate_hz": "--rate",
    "duration_s": "--duration",
    "instrument.optics.beamlets": "--beamlets",
}


@click.command(
    short_help="How late packets are on this machine, beside a control that only sleeps and writes."
)
@click.option("--rate", default="1111", show_default=True, metavar="HZ", help="Shots per second.")
@click.option("--duration", default="10", show_default=True, metavar="S", help="Length of the flight.")
@click.option("--beamlets", default="61", show_default=True, metavar="N", help="Per beam, of four beams.")
@click.option("--record", is_flag=True, help="Record the flight too, into a file that is thrown away.")
@click.option("--plot", metavar="FILE.png", help="Picture: spread, and the p99 of each second.")
@click.option("--json", "as_json", is_flag=True, help="For machines.")
def realtime(rate: str, duration: str, beamlets: str, record: bool, plot: str | None, as_json: bool) -> None:
    """Fly at level spectral over a pty that stands for a serial line of 3 Mbit/s, and tell how late every packet was.

    Beside it a control process writes as many bytes at the same instants to a pty of its own, with the same priority,
    and does nothing else: what it is late by is the machine's. docs/how-late.md explains the figures,
    docs/bench-machine.md how to make a machine better at it. Ctrl-C ends the flight; what was measured is told.

    \b
    lidar-emu bench realtime
    lidar-emu bench realtime --rate 100 --duration 600 --record --plot lateness.png
    lidar-emu bench realtime --json
    """
    if plot is not None:
        from lidar_emu.report.lateness_plot import check_plot_path

        check_plot_path(Path(plot))
    rate_hz, duration_s = as_number("--rate", rate), as_number("--duration", duration)
    count = as_count(beamlets)
    from lidar_emu.bench.realtime import RealtimeOptions, measure_realtime

    with named_by_option():
        report = measure_realtime(RealtimeOptions(rate_hz, duration_s, count, record), show)
    show("")
    if plot is not None:
        _plot(report, Path(plot))
    from lidar_emu.bench.realtime_document import realtime_document

    told = realtime_document(report)
    if as_json:
        click.echo(json.dumps(told, indent=2))
    else:
        from lidar_emu.cli.bench_realtime_table import print_realtime

        print_realtime(told)


def _plot(report: RealtimeReport, path: Path) -> None:
    from lidar_emu.report.lateness_plot import LatenessCurve, plot_lateness

    options, at_s = report.options, [window.at_s for window in report.windows]
    curves = [
        LatenessCurve(
            "emulator",
            report.emulator.due_to_written_ns(),
            at_s,
            [window.p99_ns for window in report.windows],
        ),
        LatenessCurve(
            "control",
            report.control.due_to_written_ns(),
            at_s,
            [window.control_p99_ns for window in report.windows],
        ),
    ]
    title = f"{options.rate_hz:g} shots/s, four beams of {options.beamlets} beamlets, level spectral"
    plot_lateness(curves, title, path)
    click.echo(f"{path}: {title}", err=True)


@contextmanager
def named_by_option() -> Iterator[None]:
    """Let a complaint about the scenario name the option that it comes from."""
    try:
        yield
    except InputError as error:
        raise InputError(_OPTIONS.get(error.key, error.where), None, error.value, error.allowed) from None


def show(what: str) -> None:
    """Progress, where somebody looks."""
    if sys.stderr is not None and sys.stderr.isatty():
        click.echo(f"\r\x1b[K{what}", nl=False, err=True)


def as_count(text: str) -> int:
    """What --beamlets says.

    Raises:
        InputError: it is no whole number.
    """
    try:
        return int(text)
    except ValueError:
        raise InputError("--beamlets", None, text, "allowed: a whole number") from None
