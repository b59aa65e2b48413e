"""The command line: one module per command; heavy imports stay inside the commands."""

from __future__ import annotations

import os
import platform
import sys
from errno import EMFILE
from io import TextIOWrapper
from pathlib import Path

import click

from lidar_emu._version import __version__
from lidar_emu.cli.bench import bench
from lidar_emu.cli.budget import budget
from lidar_emu.cli.campaign import campaign
from lidar_emu.cli.check import check
from lidar_emu.cli.detection import detection
from lidar_emu.cli.doctor import doctor
from lidar_emu.cli.documents import fmu, icd, new, scenarios, schema
from lidar_emu.cli.fit import fit
from lidar_emu.cli.ground import ground
from lidar_emu.cli.hazards import hazards
from lidar_emu.cli.listen import listen
from lidar_emu.cli.options import set_up_values, setting_of
from lidar_emu.cli.plan import plan
from lidar_emu.cli.replay import replay
from lidar_emu.cli.report import report
from lidar_emu.cli.run import run
from lidar_emu.cli.send import inject, send
from lidar_emu.cli.simulate import simulate
from lidar_emu.cli.terminal import check_printed, silence
from lidar_emu.cli.trial import trial
from lidar_emu.cli.view import view
from lidar_emu.errors import InputError, RunError, one_line

EXIT_FAILED, EXIT_USAGE, EXIT_INTERRUPTED = 1, 2, 130
_OF_LINUX = ("fcntl", "resource", "termios", "tty")
"""Modules that Python has on Linux alone, or not on Windows: ports and the real-time clock need them."""
_PACKAGE = Path(__file__).resolve().parents[1]
_WITH_PAGES = next((folder for folder in (_PACKAGE, _PACKAGE.parents[1]) if (folder / "docs").is_dir()), None)


@click.group(
    epilog=f"\b\nFiles named docs/... and examples/... are in\n{_WITH_PAGES}" if _WITH_PAGES else None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    invoke_without_command=True,
)
@click.version_option(__version__, prog_name="lidar-emu")
@click.pass_context
def cli(context: click.Context) -> None:
    """Emulate a multi-beam FMCW Doppler landing lidar, hardware in the loop.

    \b
    lidar-emu new my.yaml                             write a scenario to start from
    lidar-emu run descent.yaml                        fly on an in-memory loopback and print the measurements
    lidar-emu run descent.yaml --port /dev/ttyUSB0 --baud 921600
    lidar-emu run descent.yaml -i socketcan -c vcan0
    lidar-emu replay flight.mcap --port /dev/ttyUSB0  send a recording again
    lidar-emu report flight.mcap --html flight.html   summary, exports, an HTML page with figures
    lidar-emu fit flight.csv --html fit.html          a sensor characterised from a log of its flight
    lidar-emu view flight.mcap                        the flight in three dimensions, plots and events
    lidar-emu listen --port /dev/ttyUSB1 --baud 921600 --json
    lidar-emu send --port /dev/ttyUSB1 set_mode mode=track
    lidar-emu simulate descent.yaml --out descent.csv --plot descent.png
    lidar-emu campaign dispersed_descent.yaml --out results
    lidar-emu trial nominal --port pty --out trial    a flight computer graded on cases
    lidar-emu detection descent.yaml                  detection probability by altitude
    lidar-emu budget descent.yaml --at 500            uncertainty of one measurement by source
    lidar-emu hazards hazard_scan.yaml                hazards detected, and where a lander is safe
    lidar-emu ground descent.yaml --plot survey.png   heights, slopes and the footprint of the flight
    lidar-emu plan descent.yaml                       what the run computes and leaves out
    lidar-emu bench accuracy descent.yaml             error and time of every level
    lidar-emu bench stability my.yaml                 your instrument at the extremes of its keys and flight
    lidar-emu bench realtime                          lateness and jitter of packets on this machine
    lidar-emu check --port /dev/ttyUSB0               whether a scenario fits a port, its adapter and its cable
    lidar-emu doctor                                  what this machine has, and how to get what is missing
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help(), err=True)
        context.exit(EXIT_USAGE)


@click.command(name="help", short_help="Show the help of a command: help run, help bench realtime.")
@click.argument("command", nargs=-1)
def help_of(command: tuple[str, ...]) -> None:
    """Show what `lidar-emu COMMAND --help` shows.

    \b
    lidar-emu help run
    lidar-emu help bench realtime
    """
    cli([*command, "--help"], prog_name="lidar-emu", standalone_mode=False)


for command in (
    run,
    replay,
    listen,
    send,
    inject,
    simulate,
    campaign,
    trial,
    report,
    fit,
    view,
    detection,
    budget,
    hazards,
    ground,
    plan,
    bench,
    check,
    new,
    scenarios,
    schema,
    icd,
    fmu,
    doctor,
    help_of,
):
    cli.add_command(command)
set_up_values(cli)


def main() -> None:
    """Run a command: exit code 0 on success, 1 for a run that failed, 2 for a usage or scenario error."""
    _open_standard_descriptors()
    _replace_unknown_characters()
    try:
        code = cli(prog_name="lidar-emu", standalone_mode=False)
        check_printed()
        sys.exit(code)
    except InputError as error:
        _fail(str(error), EXIT_USAGE)
    except click.ClickException as error:
        if isinstance(
            error, getattr(click.exceptions, "NoArgsIsHelpError", ())
        ):  # the help itself, as of `bench`
            error.show()
            sys.exit(EXIT_USAGE)
        context = getattr(error, "ctx", None)
        if isinstance(error, click.NoSuchOption) and (setting := setting_of(error, sys.argv)):
            _fail(f"{error.message} Did you mean --set {setting}?", EXIT_USAGE)
        hint = "" if context is None else f" See: {context.command_path} --help"
        _fail(error.format_message() + hint, EXIT_USAGE)
    except RunError as error:
        _fail(str(error), EXIT_FAILED)
    except (KeyboardInterrupt, click.Abort) as end:
        if isinstance(end.__cause__, EOFError):  # click takes it for Ctrl-D at a prompt; no command prompts
            raise end.__cause__ from None
        sys.exit(EXIT_INTERRUPTED)
    except ModuleNotFoundError as error:
        if error.name not in _OF_LINUX:
            raise
        _fail(
            f"this command needs Linux: no {error.name} on {platform.system()}; "
            "this system runs simulate, campaign, plan, detection, budget, hazards, ground, report, view",
            EXIT_USAGE,
        )
    except MemoryError:
        _fail("not enough memory; a shorter --duration or a lower timing.rate_hz needs less", EXIT_FAILED)
    except OSError as error:
        silence()
        is_full = error.errno == EMFILE
        _fail("too many open files; allow 64 or more (ulimit -n)" if is_full else str(error), EXIT_FAILED)


def _open_standard_descriptors() -> None:
    """Open descriptors 0 to 2 if they are closed (`>&-`), so that no port or file takes their numbers."""
    descriptor = os.open(os.devnull, os.O_RDWR)
    while descriptor <= 2:
        descriptor = os.dup(descriptor)
    os.close(descriptor)


def _replace_unknown_characters() -> None:
    """Print `?` for a character that the terminal's encoding does not have, instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")


def _fail(message: str, code: int) -> None:
    click.echo(f"lidar-emu: {one_line(message)}", err=True)
    sys.exit(code)
