"""Commands that print documents: shipped scenarios, schema, interface control document."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

import click

from lidar_emu.cli.options import load_scenario, scenario_options
from lidar_emu.cli.terminal import print_line
from lidar_emu.errors import Finding, InputError, RunError
from lidar_emu.files import check_destination, check_suffix


@click.command(short_help="List the shipped scenarios and campaigns.")
def scenarios() -> None:
    """List the shipped scenarios and campaigns, and the folder from which to copy them."""
    from lidar_emu.scenario.parts import shipped, shipped_names

    for folder in ("scenarios", "campaigns"):
        for name in shipped_names(folder):
            path = shipped(folder) / name
            print_line(f"{name:24} {path.read_text().splitlines()[0].lstrip('# ')}")
        print_line(f"in {shipped(folder)}")


@click.command(short_help="Print the JSON schema of scenarios or campaigns, for editors.")
@click.option("--campaign", is_flag=True, help="Print the schema of campaign files.")
def schema(campaign: bool) -> None:
    """Print the JSON schema of scenario files.

    \b
    lidar-emu schema > lidar-emu.schema.json
    then in the scenario's first line, for editors with a YAML language server:
    # yaml-language-server: $schema=lidar-emu.schema.json
    """
    from lidar_emu.scenario import json_schema

    made = json_schema.campaign_schema() if campaign else json_schema.json_schema()
    print_line(json.dumps(made, indent=2))


@click.command(short_help="Write the interface for people, for C, and for other tools.")
@click.option("--out", metavar="FOLDER", default=".", show_default=True, help="Output folder.")
@click.option(
    "--interface",
    "--wire-interface",
    "name",
    metavar="FILE",
    default="default",
    show_default=True,
    help="Message definitions: a name, or FILE.toml.",
)
def icd(out: str, name: str) -> None:
    """Write files generated from the message definitions.

    INTERFACE.md for people, lidar.h for C, lidar.lua for Wireshark; lidar.dbc for CAN tools, if the interface has CAN;
    lidar.xml (XTCE) for ground stations, if its packets are space packets with the highest byte first.

    \b
    lidar-emu icd --out docs/
    lidar-emu icd --interface my.toml --out docs/
    """
    import lidar_icd
    from lidar_emu.wire import interface_named

    folder = Path(out)
    if not folder.is_dir():
        raise InputError("--out", None, out, "must be a folder that exists")
    interface = interface_named(name, "--interface")
    texts = {
        "INTERFACE.md": lidar_icd.interface_markdown(interface),
        "lidar.h": lidar_icd.c_header(interface),
        "lidar.lua": lidar_icd.dissector(interface),
    }
    if interface.can is not None:
        texts["lidar.dbc"] = lidar_icd.dbc(interface)
    if lidar_icd.has_xtce(interface):
        texts["lidar.xml"] = lidar_icd.xtce(interface)
    for file, text in texts.items():
        try:
            (folder / file).write_text(text, encoding="utf-8")
        except OSError as error:
            raise RunError(f"{folder / file}: could not be written: {error.strerror}") from None
        print_line(str(folder / file))


@click.command(short_help="Write an FMU: the lidar as a block of a simulator (FMI 2 or 3).")
@scenario_options
@click.option("--out", metavar="FILE.fmu", required=True, help="File to write.")
@click.option(
    "--fmi-version",
    type=click.Choice(["2", "3"]),
    default="2",
    show_default=True,
    help="Version of the standard: 3 has arrays, and the bytes of the packets.",
)
def fmu(
    scenario: str,
    duration: str | None,
    seed: str | None,
    settings: tuple[str, ...],
    exact: bool,
    out: str,
    fmi_version: Literal["2", "3"],
) -> None:
    """Write SCENARIO's lidar as an FMU for co-simulation, FMI 2.0 or 3.0.

    Inputs are the vehicle's position, velocity, acceleration, attitude and rate; outputs are ranges, closing speeds
    and their validity, and counters. The scenario's own trajectory is not flown. docs/fmi.md

    \b
    lidar-emu fmu descent.yaml --out lidar.fmu
    lidar-emu fmu my.yaml --out lidar.fmu --set timing.rate_hz=100
    lidar-emu fmu descent.yaml --out lidar.fmu --fmi-version 3
    """
    path = Path(out)
    check_destination(path, "--out")
    check_suffix(path, [".fmu"], "--out")
    flown = load_scenario(scenario, duration, seed, settings, exact)
    from lidar_emu.fmu.build import write_fmu
    from lidar_emu.scenario.schema import FlightScenario

    if not isinstance(flown, FlightScenario):
        raise InputError(scenario, None, Finding("a bench pattern"), "name a flight")
    write_fmu(flown, path, fmi_version)
    print_line(f"{out}: {flown.name}")
