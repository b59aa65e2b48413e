"""`lidar-emu trial`: grade a flight computer on the cases of a pack."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from threading import Event, Lock
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.options import SectionedCommand, check_plot, plot_option, port_options
from lidar_emu.cli.terminal import PREPARING, busy, duration_words, print_line, show_step, write_text
from lidar_emu.errors import Finding, InputError
from lidar_emu.files import check_destination, check_extra, made_folder

if TYPE_CHECKING:
    from lidar_emu.transports.spec import PortSpec
    from lidar_emu.trial.fly import Bench, Flown
    from lidar_emu.trial.judge import CaseVerdict
    from lidar_emu.trial.pack import Pack, PreparedCase


@click.command(cls=SectionedCommand, short_help="Grade a flight computer on the cases of a pack.")
@click.argument("pack")
@port_options
@click.option(
    "--out", metavar="DIR", help="Folder of the results: page, JSON and the recording of each flight."
)
@click.option("--only", metavar="CASE", multiple=True, help="Fly this case only. Repeatable.")
@click.option(
    "--seed", type=click.IntRange(0, 2**63 - 1), metavar="N", help="Fly this seed alone, with --only."
)
@click.option("--list", "lists", is_flag=True, help="List the cases with their questions and durations.")
@click.option("--host", metavar="COMMAND", help="Start this for each flight; {port}, {scenario}, {seed}, {case} and "
              "{truth} are replaced. Left out: your flight computer is on the port.")  # fmt: skip
@click.option("--jobs", type=click.IntRange(min=1), metavar="N", default=1, show_default=True,
              help="Flights at a time, with --host and --port pty.")  # fmt: skip
@click.option("--pace", type=click.Choice(["wall", "max", "lockstep"]), default="wall", show_default=True,
              help="In real time, as fast as the link accepts packets, or in lockstep with a simulator.")  # fmt: skip
@click.option("--solutions", metavar="FILE.csv", help="Grade this log of your navigation instead of its messages; "
              "{case} and {seed} are replaced.")  # fmt: skip
@click.option("--junit", metavar="FILE.xml", help="Write the verdicts as JUnit XML.")
@plot_option("all cases in one picture")
@click.option("--new", "new", metavar="DIR", help="Copy PACK into a new folder, to change it.")
@click.option("--json", "as_json", is_flag=True, help="Print the verdicts as JSON.")
def trial(
    pack: str,
    port: PortSpec,
    out: str | None,
    only: tuple[str, ...],
    seed: int | None,
    lists: bool,
    host: str | None,
    jobs: int,
    pace: str,
    solutions: str | None,
    junit: str | None,
    plot: tuple[str, ...],
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
    lidar-emu trial landings --port /dev/ttyUSB0 --out landings --plot landings.png
    lidar-emu trial my_pack --port udp:5600 --only cliff --out trial --solutions 'logs/{case}_{seed}.csv'
    lidar-emu trial nominal --new my_pack
    """
    from lidar_emu.runtime.options import RunOptions, live_part
    from lidar_emu.runtime.port.packets import Pace
    from lidar_emu.transports.spec import Kind
    from lidar_emu.trial.fly import Bench
    from lidar_emu.trial.judge import document
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
    _check_outputs(junit, plot)
    if port.kind is Kind.LOOPBACK and solutions is None:
        raise InputError("trial", None, Finding("no port"), "pass --port, or --interface and --channel")
    if jobs > 1 and (host is None or port.kind is not Kind.PTY or port.path):
        raise InputError(
            "--jobs",
            None,
            jobs,
            "needs --host and --port pty without a name, so that each flight has its own port",
        )
    for one in read.cases:
        if live_part(one.scenario, RunOptions(port, Pace(pace))) is not None and jobs > 1:
            raise InputError("--jobs", None, jobs, f"must be 1: {one.case.id} has one address for live truth")
    if seed is not None and not only:
        raise InputError("--seed", None, seed, "needs --only CASE")
    flown_by = [*port.to_options(), "--pace", pace]
    again = ["lidar-emu", "trial", pack, *flown_by, "--out", str(Path(out) / "again")]
    for name, value in (("--host", host), ("--solutions", solutions)):
        again += [name, value] if value is not None else []
    bench = Bench(Path(out), flown_by, host, solutions, again, Event(), lambda *_: None)
    verdicts = _fly(read, bench, jobs, seed, as_json)
    _write(read, verdicts, Path(out), junit, plot)
    if as_json:
        print_line(json.dumps(document(read, verdicts), indent=2))
    else:
        _print_verdicts(verdicts, Path(out))
    return int(not all(one.passes for one in verdicts))


def _check_outputs(junit: str | None, plot: tuple[str, ...]) -> None:
    if junit is not None:
        check_destination(Path(junit), "--junit", [".xml"])
    check_extra("trial", "the page's figures", "matplotlib", "plots")
    check_plot(plot)


def _write(
    pack: Pack, verdicts: list[CaseVerdict], out: Path, junit: str | None, plot: tuple[str, ...]
) -> None:
    from lidar_emu.trial.judge import document, junit_xml
    from lidar_emu.trial.page import overview, write_overview, write_page

    write_text(out / "trial.json", json.dumps(document(pack, verdicts), indent=2) + "\n")
    if junit is not None:
        write_text(Path(junit), junit_xml(pack, verdicts))
    with busy("drawing the page"):
        write_page(out / "trial.html", pack, verdicts, overview(pack, verdicts))
        for path in plot:
            write_overview(overview(pack, verdicts), Path(path))


class StatusLine:
    """The status line of a trial: flights that are over, the time that is left, and what the others do.

    Args:
        durations_s: duration of each planned flight; None: it is not known.
        begun_ns: instant at which the first one began.
    """

    def __init__(self, durations_s: list[float | None], begun_ns: int) -> None:
        self._count, self.done = len(durations_s), 0
        known = [each for each in durations_s if each is not None]
        self._total_s = sum(known) if len(known) == len(durations_s) else None
        self._done_s, self._begun_ns = 0.0, begun_ns
        self._ends_ns: float | None = None
        self._doing: dict[tuple[str, int], str] = {}

    def begin(self, case: str, seed: int, what: str) -> None:
        """Note what a flight does now."""
        self._doing[case, seed] = what

    def end(self, case: str, seed: int, duration_s: float | None, now_ns: int) -> int:
        """Note that a flight is over; return how many are."""
        self._doing.pop((case, seed), None)
        self.done += 1
        self._done_s += duration_s or 0.0
        if self._total_s is not None:
            # By the flights so far: starting and grading take time, and several are flown at once.
            self._ends_ns = self._begun_ns + (now_ns - self._begun_ns) * self._total_s / self._done_s
        return self.done

    def line(self, now_ns: int) -> str:
        """The line."""
        left = (
            "" if self._ends_ns is None else f", {duration_words(max(self._ends_ns - now_ns, 0) * 1e-9)} left"
        )
        doing = [f"{case}, seed {seed}: {what}" for (case, seed), what in list(self._doing.items())]
        return "; ".join([f"{self.done} of {self._count} flown{left}", *doing])


def _fly(pack: Pack, bench: Bench, jobs: int, seed: int | None, quiet: bool) -> list[CaseVerdict]:
    from lidar_emu.runtime.clock import Clock
    from lidar_emu.trial.fly import check_answers, check_host, fly_all, planned_flights
    from lidar_emu.trial.judge import judge_case

    check_host(bench.host)
    if bench.log is None:
        check_answers(pack.cases)
    _check_log(bench.log)
    made_folder("--out", str(bench.folder))
    planned, clock, lock = planned_flights(pack.cases, seed), Clock(), Lock()
    with busy(PREPARING):
        duration_s = {one.case.id: one.flight_s for one in pack.cases}
    for name in ("trial.html", "trial.json"):
        (bench.folder / name).unlink(missing_ok=True)  # of other flights
    status = StatusLine([duration_s[case.case.id] for case, _ in planned], clock.now_ns())

    def show(case: PreparedCase, seed: int, what: str) -> None:
        with lock:
            status.begin(case.case.id, seed, what)
            show_step(status.line(clock.now_ns()))

    def on_end(flown: Flown) -> None:
        with lock:
            case = flown.case.case.id
            done = status.end(case, flown.seed, duration_s[case], clock.now_ns())
            show_step("")
            if not quiet:
                print_line(f"{done} of {len(planned)}: {case}, seed {flown.seed}: {_shown(flown)}")

    try:
        flights = fly_all(planned, bench._replace(show=show), jobs, on_end)
    except KeyboardInterrupt:
        show_step("")
        done = f"{status.done} of {len(planned)} flights"
        click.echo(f"interrupted: {done} in {bench.folder}, not judged", err=True)
        raise
    finally:
        show_step("")
    return [judge_case(case, [one for one in flights if one.case is case]) for case in pack.cases]


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
            "--solutions", None, log, "must be a file name with no braces but {case} and {seed}"
        ) from None


def _copy(pack: Pack, folder: Path) -> None:
    if folder.exists():
        raise InputError("--new", None, str(folder), "must be a folder that does not exist yet")
    shutil.copytree(pack.path.parent, made_folder("--new", str(folder)), dirs_exist_ok=True)
    print_line(f"copied to {folder}: edit its pack.yaml, then fly it: lidar-emu trial {folder}")


def _print_list(pack: Pack, as_json: bool) -> None:
    if as_json:
        shown = {"id", "question", "flights"}
        rows = [one.case.model_dump(include=shown) | {"flight_s": one.flight_s} for one in pack.cases]
        print_line(json.dumps(rows, indent=2))
        return
    total_s = 0.0
    for one in pack.cases:
        required = ", ".join(each.id for each in one.requirements)
        flight_s, flights = one.flight_s, _flights(one.case.flights)
        total_s += one.case.flights * (flight_s or 0.0)
        length = "the simulator's length" if flight_s is None else f"{flight_s:.0f} s"
        print_line(f"{one.case.id}: {one.case.question} ({flights} of {length}; {required})")
    count = sum(one.case.flights for one in pack.cases)
    print_line(
        f"{len(pack.cases)} cases, {_flights(count)}: {duration_words(total_s)} in real time, one at a time"
    )


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
    passed = sum(one.passes for one in verdicts)
    print_line(f"{passed} of {len(verdicts)} cases pass; page: {out / 'trial.html'}")
    for one in verdicts:
        if not one.passes:
            missed = [each.requirement.id for each in one.judged if each.verdict != "pass"]
            print_line(f"{one.case.case.id} misses {', '.join(missed)}")
