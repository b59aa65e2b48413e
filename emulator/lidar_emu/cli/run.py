"""`lidar-emu run`: fly a scenario over a port in real time."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.options import (
    SectionedCommand,
    as_number,
    fail_on_option,
    failures_named,
    has_failed,
    json_lines_option,
    load_scenario,
    plain_option,
    port_options,
    scenario_options,
    wait_limit_option,
)
from lidar_emu.cli.terminal import (
    PREPARING,
    busy,
    has_terminal,
    print_line,
    print_lines,
    print_note,
    shows_progress,
    write_text,
)
from lidar_emu.errors import InputError, RunError
from lidar_emu.files import check_destination, check_keeps

if TYPE_CHECKING:
    from lidar_emu.recording.write import Recorder
    from lidar_emu.runtime.observer import Observer
    from lidar_emu.runtime.options import RunOptions, StartEvent
    from lidar_emu.runtime.summary import Tally
    from lidar_emu.scenario.schema import BenchScenario, FlightScenario
    from lidar_emu.shots.model import Model
    from lidar_emu.transports.spec import PortSpec
    from lidar_protocol import Interface


@click.command(
    cls=SectionedCommand,
    short_help="Fly a scenario in real time over a serial line, a CAN bus or a loopback.",
)
@scenario_options
@port_options
@click.option("--pace", type=click.Choice(["wall", "max", "lockstep"]), default="wall", show_default=True,
              help="In real time, as fast as the link accepts packets, or in lockstep with a simulator.")  # fmt: skip
@click.option("--start", default=None, metavar="now|on-connect|on-command|on-truth|UTC",
              help="Start of scenario time: the host opens the port (the default on a pty or TCP), a command makes "
                   "the device acquire, live truth arrives, or a UTC instant: 2030-01-01T12:00:00Z.")  # fmt: skip
@wait_limit_option
@click.option(
    "--control",
    metavar="PATH",
    help="Accept faults and commands on this Unix socket: lidar-emu inject PATH, send --control PATH.",
)
@click.option("--record", metavar="FILE.mcap", help="Record ground truth, measurements and packets.")
@click.option("--view", "viewer", metavar="[window|web|foxglove]", is_flag=False, flag_value="window",
              help="Show the flight while it goes on: in a window or a browser (Rerun), or to Foxglove; web:PORT or "
                   "foxglove:PORT for another port than 9090 and 8765.")  # fmt: skip
@click.option("--summary", "summary_file", metavar="FILE.json", help="Write the summary.")
@fail_on_option
@plain_option
@json_lines_option
def run(
    scenario: str,
    duration: str | None,
    seed: str | None,
    settings: tuple[str, ...],
    exact: bool,
    port: PortSpec,
    pace: str,
    start: str | None,
    wait_limit: str | None,
    control: str | None,
    record: str | None,
    viewer: str | None,
    summary_file: str | None,
    fail_on: str | None,
    plain: bool,
    as_json: bool,
) -> int:
    """Fly SCENARIO, a YAML file or a shipped one by name, and send every shot when it is due.

    Without a port the packets go through an in-memory loopback, which decodes and prints them.

    \b
    lidar-emu run descent.yaml
    lidar-emu run descent.yaml --port pty --wait-limit 600
    lidar-emu run descent.yaml --port /dev/ttyUSB0 --baud 921600 --record flight.mcap
    lidar-emu run descent.yaml -i slcan -c /dev/ttyACM0 --bitrate 1000000
    lidar-emu run live.yaml --port /dev/ttyUSB0 --start on-truth
    lidar-emu run live.yaml --pace lockstep
    lidar-emu run descent.yaml --port pty --start on-command
    lidar-emu run descent.yaml --port /dev/ttyUSB0 --control /tmp/lidar.sock
    lidar-emu run descent.yaml --view
    lidar-emu run my.yaml --pace max --fail-on dropped --summary out.json --set timing.rate_hz=100
    """
    failures = failures_named(fail_on, pace == "wall")
    if control == "":  # the system would choose an abstract name, open to every user
        raise InputError("--control", None, control, "must be a path that does not exist yet")
    starts = _start(start)
    limit_s = None if wait_limit is None else as_number("--wait-limit", wait_limit)
    for option, file, suffix in (("--record", record, ".mcap"), ("--summary", summary_file, ".json")):
        if file is not None:
            check_keeps(Path(scenario), Path(file), option)
            check_destination(Path(file), option, [suffix])
    if viewer is not None and viewer.startswith("foxglove") and pace == "max":
        raise InputError("--view", None, viewer, "needs --pace wall or lockstep: Foxglove shows what arrives")
    from lidar_emu.cli.run_lines import (
        Announcer,
        LoopbackView,
        ProgressLine,
        ReadyLine,
        summary_lines,
        why_nothing_sent,
    )
    from lidar_emu.cli.viewer_process import ViewerProcess
    from lidar_emu.runtime.options import RunOptions
    from lidar_emu.runtime.port.packets import Pace
    from lidar_emu.runtime.run import Run
    from lidar_emu.transports.spec import Kind

    flown = load_scenario(scenario, duration, seed, settings, exact)
    from lidar_emu.shots.model import build_model
    from lidar_emu.wire import interface_named

    interface = interface_named(flown.wire.interface, "scenario", "wire.interface")
    draws = not (as_json or plain) and has_terminal()
    far_end = LoopbackView(interface, quiet=as_json or draws)
    observers: list[Observer] = [far_end]
    with busy(PREPARING):
        model = build_model(flown)
        options = RunOptions(port, Pace(pace), starts, limit_s, control)
        this_run = Run(flown, model, options, observers)
    if not (draws or port.kind is Kind.LOOPBACK) and shows_progress():
        observers.append(ProgressLine(this_run.tally))
    for warning in this_run.warnings:
        print_note(f"lidar-emu: warning: {warning}")
    with ExitStack() as shown:
        watched = None if viewer is None else shown.enter_context(ViewerProcess(viewer, record))
        recorder = _recorder(record if watched is None else watched.recording, flown, options)
        observers += [observer for observer in (recorder, watched) if observer is not None]
        drawing: AbstractContextManager[list[Observer]] = nullcontext([])
        if draws:
            drawing = _display(flown, model, interface, this_run.tally, port, pace)
        else:
            observers.insert(0, ReadyLine() if as_json else Announcer(flown.name, pace))
        with drawing as displays, recorder or nullcontext():
            observers += displays
            outcome = this_run.fly()
        recording_error = None if recorder is None else recorder.error
        if record is None and recording_error is not None:
            print_note(f"lidar-emu: warning: the viewer lacks the rest of the flight: {recording_error}")
            recording_error = None
        summary = outcome.to_json() | {"far_end": far_end.counters(), "recording_error": recording_error}
        if as_json:
            print_line(json.dumps(summary))
        elif outcome.error is None or outcome.details["started_utc"] is not None:
            print_lines(summary_lines(summary))
        problems = [recording_error, outcome.error, why_nothing_sent(summary, "shots")]
        failed = next((problem for problem in problems if problem is not None), None)
        if summary_file is not None:
            try:
                write_text(Path(summary_file), json.dumps(summary, indent=2) + "\n")
            except RunError as error:  # it would have held what else failed
                failed = "; ".join(filter(None, (failed, str(error))))
        if watched is not None and outcome.error is None and not outcome.details["interrupted"]:
            watched.wait()
    if failed is not None:
        raise RunError(failed)
    return int(has_failed(outcome.tally, outcome.details["interrupted"], failures))


def _recorder(
    file: str | None, flown: FlightScenario | BenchScenario, options: RunOptions
) -> Recorder | None:
    if file is None:
        return None
    from lidar_emu.recording.write import Recorder

    return Recorder(Path(file), flown, options)


@contextmanager
def _display(
    flown: FlightScenario | BenchScenario,
    model: Model,
    interface: Interface,
    tally: Tally,
    port: PortSpec,
    pace: str,
) -> Iterator[list[Observer]]:
    from lidar_emu.cli.dashboard import Dashboard
    from lidar_emu.cli.displays import RunDisplay, scheduled_events
    from lidar_emu.cli.run_lines import Announcer
    from lidar_emu.transports.spec import Kind

    events = scheduled_events(flown, None if model.flight is None else model.flight.trajectory)
    with Dashboard() as dashboard:
        display = RunDisplay(dashboard, interface, port.kind is Kind.CAN, tally, flown.duration_s, events)
        yield [Announcer(flown.name, pace, dashboard.print_line), display]


def _start(text: str | None) -> StartEvent | datetime | None:
    from lidar_emu.runtime.clock import Clock
    from lidar_emu.runtime.options import StartEvent

    if text is None or text in tuple(StartEvent):
        return None if text is None else StartEvent(text)
    try:
        instant = datetime.fromisoformat(text)
    except ValueError:
        remedy = f"must be {', '.join(StartEvent)}, or an instant as 2030-01-01T12:00:00Z"
        raise InputError("--start", None, text, remedy) from None
    instant = instant.replace(tzinfo=UTC) if instant.tzinfo is None else instant
    # Checked again when the run begins; here, before the kernels are compiled, the error comes sooner.
    if instant < Clock().utc_now():
        raise InputError("--start", None, text, "must be a future instant")
    return instant
