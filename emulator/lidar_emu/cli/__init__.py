"""The command line: one group, a file per family of commands, heavy imports inside the commands."""

from __future__ import annotations

import os
import sys

import click

from lidar_emu import __version__
from lidar_emu.cli.bench import bench
from lidar_emu.cli.campaign import campaign
from lidar_emu.cli.detection import detection
from lidar_emu.cli.documents import icd, scenarios, schema
from lidar_emu.cli.ground import ground
from lidar_emu.cli.hazards import hazards
from lidar_emu.cli.inject import inject
from lidar_emu.cli.listen import listen
from lidar_emu.cli.output import silence
from lidar_emu.cli.plan import plan
from lidar_emu.cli.replay import replay
from lidar_emu.cli.report import report
from lidar_emu.cli.run import run
from lidar_emu.cli.send import send
from lidar_emu.cli.simulate import simulate
from lidar_emu.errors import InputError, RunError, one_line

EXIT_FAILED, EXIT_USAGE, EXIT_INTERRUPTED = 1, 2, 130


@click.group(
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    invoke_without_command=True,
)
@click.version_option(__version__, prog_name="lidar-emu")
@click.pass_context
def cli(context: click.Context) -> None:
    """Stand in for a multi-beam FMCW Doppler landing lidar.

    \b
    lidar-emu run descent.yaml                        fly on an in-memory loopback, show what arrives
    lidar-emu run descent.yaml --port /dev/ttyUSB0 --baud 921600
    lidar-emu run descent.yaml -i socketcan -c vcan0
    lidar-emu replay flight.mcap --port /dev/ttyUSB0  what run --record has kept, again
    lidar-emu report flight.mcap --html flight.html   what is in it: table, exports, a page with figures
    lidar-emu listen --port /dev/ttyUSB1 --baud 921600 --json
    lidar-emu send --port /dev/ttyUSB1 set_mode mode=track
    lidar-emu simulate descent.yaml --out descent.csv --plot descent.png
    lidar-emu campaign dispersed_descent.yaml --out results
    lidar-emu report --paper-figure 2                 figures of the published simulation, drawn again
    lidar-emu detection descent.yaml                  what the instrument will detect, by altitude
    lidar-emu hazards hazards.yaml                    which boulders, steps and slopes the points tell
    lidar-emu ground descent.yaml --set site=cratered --plot ground.png
    lidar-emu plan descent.yaml                       what the run computes and what it leaves out
    lidar-emu bench accuracy descent.yaml             error and time of every level
    lidar-emu bench realtime                          how late packets are on this machine
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


for command in (
    run,
    replay,
    listen,
    send,
    inject,
    simulate,
    campaign,
    report,
    detection,
    hazards,
    ground,
    plan,
    bench,
    scenarios,
    schema,
    icd,
):
    cli.add_command(command)


def main() -> None:
    """Run a command: exit code 0 on success, 1 for a run that failed, 2 for what the user has to mend."""
    _open_standard_descriptors()
    try:
        sys.exit(cli(prog_name="lidar-emu", standalone_mode=False))
    except InputError as error:
        _complain(str(error), EXIT_USAGE)
    except click.ClickException as error:
        _complain(error.format_message() + _where_to_look(error), EXIT_USAGE)
    except RunError as error:
        _complain(str(error), EXIT_FAILED)
    except (KeyboardInterrupt, click.Abort) as end:
        if isinstance(end.__cause__, EOFError):  # click takes it for Ctrl-D at a prompt; no command prompts
            raise end.__cause__ from None
        sys.exit(EXIT_INTERRUPTED)
    except MemoryError:
        _complain("not enough memory; a shorter --duration or a lower timing.rate_hz needs less", EXIT_FAILED)
    except OSError as error:
        silence()
        _complain(str(error), EXIT_FAILED)


def _open_standard_descriptors() -> None:
    """Started with `>&-` or the like: no port and no file may become descriptor 0, 1 or 2 in its place."""
    descriptor = os.open(os.devnull, os.O_RDWR)
    while descriptor <= 2:
        descriptor = os.dup(descriptor)
    os.close(descriptor)


def _where_to_look(error: click.ClickException) -> str:
    context = getattr(error, "ctx", None)
    return "" if context is None else f" What is allowed: {context.command_path} --help"


def _complain(message: str, code: int) -> None:
    click.echo(f"lidar-emu: {one_line(message)}", err=True)
    sys.exit(code)
