"""`lidar-emu trial`: grade a flight computer on the cases of a pack."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.options import SectionedCommand, port_options
from lidar_emu.cli.terminal import busy, print_line, write_text
from lidar_emu.errors import Finding, InputError, RunError
from lidar_emu.files import check_destination, check_extra, check_suffix

if TYPE_CHECKING:
    from lidar_emu.recording.read import Recording
    from lidar_emu.transports.spec import PortSpec
    from lidar_emu.trial.fly import Flown
    from lidar_emu.trial.judge import CaseVerdict
    from lidar_emu.trial.pack import Pack, PreparedCase
    from lidar_emu.trial.solutions import Solutions


@click.command(cls=SectionedCommand, short_help="Grade a flight computer on the cases of a pack.")
@click.argument("pack")
@port_options
@click.option(
    "--out", metavar="DIR", help="Folder of the results: page, JSON and the recording of each flight."
)
@click.option("--only", metavar="CASE", multiple=True, help="Fly this case only. Repeatable.")
@click.option("--list", "lists", is_flag=True, help="List the cases and what they ask.")
@click.option("--host", metavar="COMMAND", help="Start this for each flight; {port}, {scenario}, {seed}, {case} and "
              "{truth} are replaced. Left out: your flight computer is on the port.")  # fmt: skip
@click.option("--jobs", type=click.IntRange(min=1), metavar="N", default=1, show_default=True,
              help="Flights at a time, with --host and --port pty.")  # fmt: skip
@click.option("--pace", type=click.Choice(["wall", "max", "lockstep"]), default="wall", show_default=True,
              help="In real time, as fast as the link accepts packets, or in lockstep with a simulator.")  # fmt: skip
@click.option("--solutions", metavar="FILE.csv", help="Grade this log of your navigation instead of its messages; "
              "{case} and {seed} are replaced.")  # fmt: skip
@click.option("--junit", metavar="FILE.xml", help="Write the verdicts as JUnit XML.")
@click.option("--new", "new", metavar="DIR", help="Copy PACK into a new folder, to change it.")
@click.option("--json", "as_json", is_flag=True, help="Print the verdicts as JSON.")
def trial(
    pack: str,
    port: PortSpec,
    out: str | None,
    only: tuple[str, ...],
    lists: bool,
    host: str | None,
    jobs: int,
    pace: str,
    solutions: str | None,
    junit: str | None,
    new: str | None,
    as_json: bool,
) -> int:
    """Fly the cases of PACK, a folder or a shipped one by name, against a flight computer, and grade its navigation.

    \b
    The flight computer answers with navigation messages (INTERFACE.md), or its log is graded. The exit code is 1 unless
    all requirements pass.

    \b
    lidar-emu trial nominal --list
    lidar-emu trial nominal --port /dev/ttyUSB0 --out trial
    lidar-emu trial nominal --port pty --host './my_navigation {port}' --out trial --junit trial.xml
    lidar-emu trial my_pack --port udp:5600 --only cliff --out trial --solutions 'logs/{case}_{seed}.csv'
    lidar-emu trial nominal --new my_pack
    """
    from lidar_emu.runtime.options import RunOptions, live_part
    from lidar_emu.runtime.port.packets import Pace
    from lidar_emu.transports.spec import Kind
    from lidar_emu.trial.pack import read_pack

    read = read_pack(pack, list(only))
    if new is not None:
        _copy(read, Path(new))
        return 0
    if lists:
        _print_list(read, as_json)
        return 0
    if out is None:
        raise InputError("trial", None, Finding("no output"), "pass --out DIR, or --list")
    if junit is not None:
        check_destination(Path(junit), "--junit")
        check_suffix(Path(junit), [".xml"], "--junit")
    check_extra("trial", "the page's figures", "matplotlib", "plots")
    if port.kind is Kind.LOOPBACK and solutions is None:
        raise InputError("trial", None, Finding("no port"), "pass --port, or --interface and --channel")
    if jobs > 1 and (host is None or port.kind is not Kind.PTY or port.path):
        raise InputError(
            "--jobs", None, jobs, "needs --host, and --port pty without a name, for each flight its own"
        )
    for one in read.cases:
        if live_part(one.scenario, RunOptions(port, Pace(pace))) is not None and jobs > 1:
            raise InputError("--jobs", None, jobs, f"must be 1: {one.case.id} has one address for live truth")
    verdicts = _fly(read, Path(out), [*port.to_options(), "--pace", pace], host, jobs, solutions, as_json)
    from lidar_emu.trial.judge import document, junit_xml

    found = document(read, verdicts)
    write_text(Path(out) / "trial.json", json.dumps(found, indent=2) + "\n")
    if junit is not None:
        write_text(Path(junit), junit_xml(read, verdicts))
    if as_json:
        print_line(json.dumps(found, indent=2))
    else:
        _print_verdicts(verdicts, Path(out))
    failed = [one.case.case.id for one in verdicts if not one.passes]
    if failed:
        raise RunError(f"{len(failed)} of {len(verdicts)} cases do not pass: {', '.join(failed)}")
    return 0


def _fly(
    pack: Pack, out: Path, port: list[str], host: str | None, jobs: int, log: str | None, quiet: bool
) -> list[CaseVerdict]:
    from lidar_emu.trial.fly import Bench, check_host, fly_all
    from lidar_emu.trial.judge import judge_case
    from lidar_emu.trial.page import write_page

    check_host(host)
    _check_log(log)
    for name in ("trial.html", "trial.json"):
        (out / name).unlink(missing_ok=True)  # of other flights
    count = sum(one.case.flights for one in pack.cases)
    done = 0

    def tell(flown: Flown) -> None:
        nonlocal done
        done += 1
        if not quiet:
            print_line(f"{done} of {count}: {flown.case.case.id}, seed {flown.seed}: {_shown(flown)}")

    def stated(recording: Recording, case: PreparedCase, seed: int) -> Solutions:
        from lidar_emu.trial.solutions import read_solutions, recorded_solutions

        if log is None:
            return recorded_solutions(recording)
        return read_solutions(Path(log.format(case=case.case.id, seed=seed)))

    bench = Bench(out, port, host, stated, Event())
    flights = fly_all(pack.cases, bench, jobs, tell)
    verdicts = [judge_case(case, [one for one in flights if one.case is case]) for case in pack.cases]
    with busy("writing the page"):
        write_page(out / "trial.html", pack, verdicts)
    return verdicts


def _shown(flown: Flown) -> str:
    if flown.grade is None:
        return flown.problem
    figures = flown.grade.figures
    return f"{figures['solutions']:.0f} solutions, available {100 * figures['available_share']:.0f} %"


def _check_log(log: str | None) -> None:
    if log is None:
        return
    try:
        log.format(case="x", seed=1)
    except (ValueError, KeyError, IndexError):
        raise InputError(
            "--solutions", None, log, "must be a file name; in braces are {case} and {seed}"
        ) from None


def _copy(pack: Pack, folder: Path) -> None:
    if folder.exists():
        raise InputError("--new", None, str(folder), "must be a folder that does not exist yet")
    shutil.copytree(pack.path.parent, folder)
    print_line(f"{folder}: change pack.yaml, and fly it: lidar-emu trial {folder}")


def _print_list(pack: Pack, as_json: bool) -> None:
    if as_json:
        rows = [
            {"id": one.case.id, "question": one.case.question, "flights": one.case.flights}
            for one in pack.cases
        ]
        print_line(json.dumps(rows, indent=2))
        return
    for one in pack.cases:
        required = ", ".join(each.id for each in one.requirements)
        print_line(f"{one.case.id}: {one.case.question} ({_flights(one.case.flights)}; {required})")


def _flights(count: int) -> str:
    return "1 flight" if count == 1 else f"{count} flights"


def _print_verdicts(verdicts: list[CaseVerdict], out: Path) -> None:
    from lidar_emu.cli.plain_console import PlainConsole, plain_table
    from lidar_emu.trial.judge import cells

    table = plain_table("case", "requirement", "verdict", "worst", "limit", "flights", texts=3)
    for one in verdicts:
        for each in one.judged:
            table.add_row(one.case.case.id, each.requirement.id, str(each.verdict), *cells(each))
    PlainConsole().print(table)
    print_line(f"page: {out / 'trial.html'}")
