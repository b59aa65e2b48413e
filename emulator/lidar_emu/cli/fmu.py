"""`lidar-emu fmu`: write an FMU, an emulated lidar for a simulator by the standard FMI."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from lidar_emu.cli.options import load_scenario, scenario_options
from lidar_emu.cli.output import print_line
from lidar_emu.errors import Finding, InputError
from lidar_emu.files import check_destination, check_suffix


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
    check_suffix(path, [".fmu"])
    check_destination(path, "--out")
    flown = load_scenario(scenario, duration, seed, settings, exact)
    from lidar_emu.fmu.build import write_fmu
    from lidar_emu.scenario.schema import FlightScenario

    if not isinstance(flown, FlightScenario):
        raise InputError(scenario, None, Finding("a bench pattern"), "must be a flight")
    write_fmu(flown, path, fmi_version)
    print_line(f"{out}: {flown.name}")
