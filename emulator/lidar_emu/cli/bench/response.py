"""`lidar-emu bench response`: latency from live truth to the last byte written."""

from __future__ import annotations

import json
from typing import Any

import click

from lidar_emu.cli.bench.realtime import (
    as_count,
    figure_cells,
    figures_table,
    named_by_option,
    print_ratio,
)
from lidar_emu.cli.options import as_number
from lidar_emu.cli.terminal import print_line, show_step


@click.command(short_help="Latency from a simulator's truth to the wire, compared with a control process.")
@click.option("--rate", default="100", show_default=True, metavar="HZ", help="Shots and truths per second.")
@click.option("--duration", default="10", show_default=True, metavar="S", help="Length of the flight.")
@click.option("--beamlets", default="61", show_default=True, metavar="N", help="Per beam, of four beams.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def response(rate: str, duration: str, beamlets: str, as_json: bool) -> None:
    """Fly on a simulator's live truth at level spectral, each shot just in time, over a pty that represents 3 Mbit/s.

    The latency runs from the instant at which the simulator sends its datagram until the packet's last byte is written.
    Half a period later the simulator sends the same to a control process, which writes as many bytes to another pty.
    The ratio is that of the control's median latency to the emulator's: 1 would be an emulator that takes no time.

    \b
    lidar-emu bench response
    lidar-emu bench response --rate 20 --duration 60 --json
    """
    rate_hz, duration_s, count = (
        as_number("--rate", rate),
        as_number("--duration", duration),
        as_count(beamlets),
    )
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
    console.print(
        f"{document['rate_hz']:g} shots/s, four beams of {document['beamlets']} beamlets; {shots['sent']} sent, "
        f"{shots['late']} late; host steal {document['steal_ticks']} ticks",
        highlight=False,
        soft_wrap=True,
    )
