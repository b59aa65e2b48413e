"""Commands that write documents: a scenario to start from, the schema, the interface control document, an FMU."""

from __future__ import annotations

import json
import shlex
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from lidar_emu.cli.options import load_scenario, scenario_options
from lidar_emu.cli.terminal import print_line, write_text
from lidar_emu.errors import Finding, InputError, RunError, did_you_mean, nearest, one_line, reason_of
from lidar_emu.files import check_destination, check_suffix, made_folder

if TYPE_CHECKING:
    from lidar_emu.scenario.scanner import AltitudeSwitch, TimeSwitch
    from lidar_emu.scenario.schema import BenchScenario, FlightScenario
    from lidar_icd import ScannerBeams
    from lidar_protocol import Interface

_FIRST_COMMANDS = {
    "scenarios": ("plan {}", "run {}", "run {} --port pty:lidar --baud 921600     # for your driver"),
    "campaigns": ("campaign {} --plan", "campaign {} --out results"),
}
_PAGE_OF_KEYS = {"scenarios": "docs/scenario-reference.md", "campaigns": "docs/campaigns.md"}


@click.command(short_help="Write a scenario to start from, with a comment at each key.")
@click.argument("file")
@click.option("--from", "source", metavar="NAME", default="descent.yaml", show_default=True,
              help="Shipped scenario or campaign; lidar-emu scenarios lists them.")  # fmt: skip
def new(file: str, source: str) -> None:
    """Write FILE, a scenario that runs at once: a shipped one, with the meaning of each key, for you to change.

    \b
    lidar-emu new my.yaml
    lidar-emu new my.yaml --from powered_descent.yaml
    lidar-emu new campaign.yaml --from dispersed_descent.yaml
    """
    path = Path(file)
    check_suffix(path, [".yaml", ".yml"])
    check_destination(path)
    from lidar_emu.scenario.commented import commented_text, shipped_files

    known = shipped_files()
    copied = known.get(source) or known.get(f"{source}.yaml")
    if copied is None:
        hint = did_you_mean(nearest(source, known))
        raise InputError("--from", None, source, f"{hint}must be one of {', '.join(known)}")
    folder, named = copied.parent.name, one_line(shlex.quote(file))
    lines = [
        copied.read_text(encoding="utf-8").splitlines()[0],
        f"# Copied from {copied.name}. A key ends in its unit, and has a default where it is left out: all keys are in",
        f"# {_PAGE_OF_KEYS[folder]}, in the folder that lidar-emu --help names.",
        "#",
        *(f"#   lidar-emu {words.format(named)}" for words in _FIRST_COMMANDS[folder]),
    ]
    text = "\n".join([*lines, "", commented_text(copied, one_line(path.stem))])
    try:
        with path.open("x", encoding="utf-8") as opened:
            opened.write(text)
    except FileExistsError:
        raise InputError(file, None, Finding("exists already"), "choose another name") from None
    except OSError as error:
        with suppress(OSError):
            path.unlink()
        raise RunError(f"{file}: could not be written: {reason_of(error)}") from None
    print_line(f"{file}: from {copied.name}; its first lines say how to run it")


@click.command(short_help="List the shipped scenarios and campaigns.")
def scenarios() -> None:
    """List the shipped scenarios and campaigns, and their folder; `lidar-emu new` writes one for you to change."""
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
@click.argument("scenario", default="descent.yaml")
@click.option(
    "--out", metavar="FOLDER", default=".", show_default=True, help="Output folder; made if missing."
)
@click.option(
    "--interface",
    "--wire-interface",
    "name",
    metavar="FILE",
    help="Message definitions: a name, or FILE.toml; left out, the scenario's.",
)
def icd(scenario: str, out: str, name: str | None) -> None:
    """Write files generated from the message definitions of SCENARIO, and the directions of its beams.

    INTERFACE.md for people, lidar.h for C, lidar.lua for Wireshark; lidar.dbc for CAN tools, if the interface has CAN;
    lidar.xml (XTCE) for ground stations, if its packets are space packets with the highest byte first; cosmos/, a
    plugin for OpenC3 COSMOS with the unit and the number of beams of SCENARIO.

    \b
    lidar-emu icd --out docs/
    lidar-emu icd my.yaml --out docs/
    lidar-emu icd --interface my.toml --out docs/
    """
    import lidar_icd
    from lidar_emu.scenario.load import load
    from lidar_emu.wire import interface_named

    loaded = load(scenario)
    if name is None:
        interface = interface_named(loaded.wire.interface, scenario, "wire.interface")
    else:
        interface = interface_named(name, "--interface")
    folder = made_folder("--out", out)
    texts = {
        "INTERFACE.md": interface_document(interface, Path(scenario).name, loaded),
        "lidar.h": lidar_icd.c_header(interface),
        "lidar.lua": lidar_icd.dissector(interface),
    }
    if interface.can is not None:
        texts["lidar.dbc"] = lidar_icd.dbc(interface)
    if lidar_icd.has_xtce(interface):
        texts["lidar.xml"] = lidar_icd.xtce(interface)
    unit = loaded.wire.unit if loaded.wire.unit < interface.units else 0
    plugin = lidar_icd.cosmos(interface, unit, _counts(loaded)[0])
    texts |= {f"cosmos/{file}": text for file, text in plugin.items()}
    for file, text in texts.items():
        made_folder("--out", str((folder / file).parent))
        write_text(folder / file, text)
        print_line(str(folder / file))


def interface_document(interface: Interface, name: str, scenario: FlightScenario | BenchScenario) -> str:
    """INTERFACE.md of an interface, with the beams and the device of a scenario."""
    import lidar_icd
    from lidar_emu.device.commands import followed_arguments, modes_before, modes_of_commands

    device = scenario.device
    behaviour = lidar_icd.DocumentedDevice(
        scenario=name,
        start=device.start,
        after_boot=device.after_boot,
        boot_s=device.boot_s,
        self_test_s=device.self_test_s,
        warm_restart_s=device.warm_restart_s,
        acquisition_s=device.acquisition_s,
        rate_hz=scenario.timing.rate_hz,
        settling_s=device.settling_s,
        housekeeping_rate_hz=device.housekeeping_rate_hz,
        polled=scenario.wire.polled,
        pulse_line=device.clock.pulse_line,
        lock_s=device.clock.lock_s or 0.0,
        pulse_out=device.clock.pulse_out,
        holdover_s=device.clock.holdover_s,
        arguments=followed_arguments(scenario.timing.rate_hz, *_counts(scenario)),
        modes_of_commands=modes_of_commands(),
        modes_before=modes_before(),
    )
    return lidar_icd.interface_markdown(interface, _scanner_beams(name, scenario), behaviour)


def _counts(scenario: FlightScenario | BenchScenario) -> tuple[int, int]:
    """Number of beams, and number of their patterns."""
    from lidar_emu.scenario.schema import BenchScenario

    if isinstance(scenario, BenchScenario):
        return len(scenario.bench_pattern.beams), 1
    return scenario.scanner.beam_count, len(scenario.scanner.patterns)


def _scanner_beams(name: str, scenario: FlightScenario | BenchScenario) -> ScannerBeams | None:
    """Published directions of all beams of a scenario; None without a scanner."""
    from lidar_emu.beams.patterns import build_scanner, mounting_rotation
    from lidar_emu.numerics.vector_arrays import rotate
    from lidar_emu.scenario.schema import BenchScenario
    from lidar_icd import BeamAxis, ScannerBeams

    if isinstance(scenario, BenchScenario):
        return None
    unscanned = scenario.scanner.model_copy(update={"scan": None})
    body = rotate(mounting_rotation(scenario.mounting), build_scanner(unscanned).published_sensor)
    patterns = [
        [BeamAxis(*beam, tuple(axis)) for beam, axis in zip(pattern.beams_deg, axes.tolist(), strict=False)]
        for pattern, axes in zip(unscanned.patterns, body, strict=True)
    ]
    switches = ["from the start", *(_switch_text(switch) for switch in scenario.scanner.switches)]
    scans = scenario.scanner.scan is not None
    return ScannerBeams(name, patterns, switches, scenario.mounting.lever_arm_m, scans)


def _switch_text(switch: AltitudeSwitch | TimeSwitch) -> str:
    if switch.kind == "time":
        return f"from {switch.at_s:g} s on"
    return f"from {switch.below_m:g} m above the {switch.datum} downward"


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
    check_destination(path, "--out", [".fmu"])
    flown = load_scenario(scenario, duration, seed, settings, exact)
    from lidar_emu.fmu.build import write_fmu
    from lidar_emu.scenario.load import require_flight

    write_fmu(require_flight(flown), path, fmi_version)
    print_line(f"{out}: {flown.name}")
