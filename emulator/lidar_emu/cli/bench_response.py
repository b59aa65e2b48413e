"""`lidar-emu bench response`: from truth in to the last byte written."""

from __future__ import annotations

import json
from typing import Any

import click

from lidar_emu.cli.bench_realtime import as_count, named_by_option, show
from lidar_emu.cli.options import as_number


@click.command(
    short_help="How soon a simulator's truth is a packet on the wire, beside a control that only writes."
)
@click.option("--rate", default="100", show_default=True, metavar="HZ", help="Shots and truths per second.")
@click.option("--duration", default="10", show_default=True, metavar="S", help="Length of the flight.")
@click.option("--beamlets", default="61", show_default=True, metavar="N", help="Per beam, of four beams.")
@click.option("--json", "as_json", is_flag=True, help="For machines.")
def response(rate: str, duration: str, beamlets: str, as_json: bool) -> None:
    """Fly by a simulator's truth at level spectral, each shot just in time, over a pty that stands for 3 Mbit/s.

    Counted from the instant at which the simulator sends its datagram until the packet's last byte is written. Half a
    period later the simulator sends the same to a control, which writes as many bytes to a pty of its own at once.

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
        report = measure_response(rate_hz, duration_s, count, show)
    show("")
    told: dict[str, Any] = {
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
        click.echo(json.dumps(told, indent=2))
        return
    from lidar_emu.cli.bench_realtime_table import print_response

    print_response(told)
