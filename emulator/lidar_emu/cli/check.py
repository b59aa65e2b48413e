"""`lidar-emu check`: whether a scenario fits a port, its adapter and its cable."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import click

from lidar_emu.cli.bench_latency import figure_cells, figures_table, histogram_lines, privilege_lines
from lidar_emu.cli.options import (
    SectionedCommand,
    as_number,
    load_scenario,
    ports_options,
    require_port,
    settings_option,
)
from lidar_emu.cli.terminal import print_line, show_step
from lidar_emu.errors import InputError

if TYPE_CHECKING:
    from lidar_emu.transports.spec import PortSpec

_DAY_S = 86_400


@click.command(cls=SectionedCommand, short_help="Try a port and its cable with the packets of a scenario.")
@click.argument("scenario", default="descent.yaml")
@settings_option
@ports_options
@click.option("--duration", default="60", show_default=True, metavar="S", help="Length of the check.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def check(
    scenario: str, settings: tuple[str, ...], ports: list[PortSpec], duration: str, as_json: bool
) -> int:
    """Send packets of SCENARIO (descent.yaml) at its rate, and say whether it fits: exit code 0 if it does, 1 if not.

    With one --port a plug joins its transmitter (TXD) and receiver (RXD). With two, a cable or a bus joins them: the
    first is the device's, and commands come from the second, 10 a second. Counted are packets that did not arrive,
    damaged ones and stray bytes; measured are lateness (due until written), transit (written until arrived) and
    turnaround (command written until its acknowledgement has arrived), at the far end by Python. Ctrl-C ends it early.

    \b
    lidar-emu check --port /dev/ttyUSB0 --baud 921600                      # with a loopback plug
    lidar-emu check my.yaml --port /dev/ttyUSB0 --port /dev/ttyUSB1 --baud 460800 --serial-format 8E1
    lidar-emu check -i socketcan -c can0 -c can1 --bitrate 1000000 --duration 600
    """
    duration_s = as_number("--duration", duration)
    if duration_s > _DAY_S:
        raise InputError("--duration", None, duration, f"must be at most a day, {_DAY_S} s")
    require_port(ports[0], "check")
    if len(ports) > 2:
        raise InputError("check", None, str(ports[2]), "must be one port or two")
    flown = load_scenario(scenario, None, None, (*settings, "faults=[]"))  # they are none of the cable
    from lidar_emu.bench.link_check import check_link

    document = check_link(flown, ports, duration_s, show_step).to_json()
    show_step("")
    if as_json:
        print_line(json.dumps(document, indent=2))
    else:
        _print(document)
    return int(not document["fits"])


def _print(document: dict[str, Any]) -> None:
    from lidar_emu.cli.plain_console import PlainConsole

    console, load = PlainConsole(), document["wire_load"]
    share = "" if not load else f", {100 * load:.0f} % of the wire"
    title = f"{document['scenario']}: {document['rate_hz']:g} packets/s of {document['packet']}{share}"
    console.print_lines(title)
    table = figures_table("us")
    for name in ("lateness", "transit", "turnaround"):
        table.add_row(name, *figure_cells(document[name]))
    console.print(table)
    console.print_lines(
        f"packets    {document['due']} due, {document['sent']} sent, {document['arrived']} arrived, "
        f"{document['damaged']} damaged; {document['skipped_bytes']} stray bytes; {document['commands']} commands",
        *(f"link       {event}" for event in document["link_events"]),
        *(
            f"adapter    {port} waits {wait} ms before it passes on what it received: docs/timing.md"
            for port, wait in document["latency_timer_ms"].items()
            if wait > 1
        ),
        *privilege_lines(document),
        "",
        *histogram_lines({"packets": document["histogram"]["lateness"]}, document["histogram"]["edges_ns"]),
        "",
        *(["the check was interrupted"] if document["interrupted"] else []),
        "it fits" if document["fits"] else f"it does not fit: {'; '.join(document['problems'])}",
    )
