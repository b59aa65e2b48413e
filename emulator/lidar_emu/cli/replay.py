"""`lidar-emu replay`: a recording sent again, exported to another format, or recomputed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lidar_emu.cli.options import (
    SectionedCommand,
    as_instant,
    as_number,
    fail_on_option,
    failures_named,
    has_failed,
    json_lines_option,
    port_options,
    require_port,
    wait_limit_option,
)
from lidar_emu.cli.terminal import PREPARING, busy, print_line, print_lines, shows_progress, write_text
from lidar_emu.errors import Finding, InputError, RunError
from lidar_emu.files import check_destination, check_keeps

if TYPE_CHECKING:
    from lidar_emu.recording.traffic import Traffic
    from lidar_emu.runtime.observer import Observer
    from lidar_emu.transports.spec import PortSpec


@click.command(
    cls=SectionedCommand, short_help="Send a recording again, export it, or recompute it and compare."
)
@click.argument("file")
@port_options
@click.option(
    "--speed", default="1", show_default=True, metavar="X", help="Speed relative to the recording, or max."
)
@click.option(
    "--start",
    type=click.Choice(["now", "on-connect"]),
    help="Start at once, or when the host opens the port (the default on a pty or TCP).",
)
@wait_limit_option
@click.option("--from", "from_s", metavar="S", help="Start at this instant, in seconds of the recording.")
@click.option("--until", "until_s", metavar="S", help="Stop before this instant.")
@click.option("--loop", is_flag=True, help="Repeat until Ctrl-C.")
@click.option(
    "--to",
    metavar="FILE",
    help="Write a capture (.pcap), space packets (.ccsds) or a CAN log (.log, .asc, .blf) instead.",
)
@click.option("--recompute", is_flag=True, help="Recompute the run and compare packet by packet.")
@click.option("--summary", "summary_file", metavar="FILE.json", help="Write the summary.")
@fail_on_option
@json_lines_option
def replay(
    file: str,
    port: PortSpec,
    speed: str,
    start: str | None,
    wait_limit: str | None,
    from_s: str | None,
    until_s: str | None,
    loop: bool,
    to: str | None,
    recompute: bool,
    summary_file: str | None,
    fail_on: str | None,
    as_json: bool,
) -> int:
    """Send the packets of FILE again, each when it is due, byte for byte.

    FILE is a recording (`lidar-emu run --record`), or traffic of a real instrument: a capture (.pcap, .pcapng: UDP,
    serial, SocketCAN), or a CAN log (.log, .asc, .blf, .trc).

    \b
    lidar-emu replay flight.mcap --port /dev/ttyUSB0 --baud 921600
    lidar-emu replay flight.mcap --port pty --from 30 --until 45 --speed 0.5 --loop
    lidar-emu replay candump.log -i socketcan -c vcan0 --speed max
    lidar-emu replay flight.mcap --to flight.pcap
    lidar-emu replay flight.mcap --recompute
    """
    failures = failures_named(fail_on, speed != "max")
    if summary_file is not None:
        check_destination(Path(summary_file), "--summary", [".json"])
    from_time_s = None if from_s is None else as_instant("--from", from_s)
    until_time_s = None if until_s is None else as_instant("--until", until_s)
    times_s = from_time_s, until_time_s
    sending = {
        "--speed": speed if speed != "1" else None,
        "--start": start,
        "--wait-limit": wait_limit,
        "--loop": loop or None,
        "--fail-on": fail_on,
    }
    windows = {"--from": from_s, "--until": until_s}
    if recompute:
        _reject("--recompute", {**sending, **windows, "--to": to, **_port_option(port)})
        return _compare(Path(file), summary_file, as_json)
    if to is not None:
        _reject("--to", {**sending, "--summary": summary_file, **_port_option(port)})
        _write(Path(file), Path(to), *times_s)
        return 0
    starting = start, None if wait_limit is None else as_number("--wait-limit", wait_limit)
    return _send(Path(file), port, speed, starting, times_s, loop, failures, summary_file, as_json)


def _send(
    file: Path,
    port: PortSpec,
    speed: str,
    starting: tuple[str | None, float | None],
    times_s: tuple[float | None, float | None],
    loop: bool,
    failures: set[str],
    summary_file: str | None,
    as_json: bool,
) -> int:
    from lidar_emu.cli.run_lines import (
        Announcer,
        LoopbackView,
        ProgressLine,
        ReadyLine,
        replay_lines,
        why_nothing_sent,
    )
    from lidar_emu.recording.traffic import read_traffic
    from lidar_emu.runtime.options import StartEvent
    from lidar_emu.runtime.port.packets import Pace
    from lidar_emu.runtime.replay import Replay
    from lidar_emu.transports.spec import Kind
    from lidar_protocol import default_interface

    pace = Pace.MAX if speed == "max" else Pace.WALL
    factor = 1.0 if pace is Pace.MAX else as_number("--speed", speed)
    with busy(f"reading {file}"):
        traffic = read_traffic(file).within(*times_s)
    recording = traffic.recording
    if recording is not None:
        port = port.on_line(recording.interface.serial_format)
    load = _check_port(traffic, port, factor, pace is Pace.WALL)
    view = LoopbackView(default_interface() if recording is None else recording.interface, quiet=as_json)
    shown = "max" if pace is Pace.MAX else "as recorded" if factor == 1 else f"{factor:g} times as recorded"
    observers: list[Observer] = [ReadyLine() if as_json else Announcer(file.name, shown), view]
    packets = traffic.scheduled(factor, None if loop else 1)
    longest = max(len(payload) for _, payload in traffic.packets)
    start, limit_s = starting
    event = None if start is None else StartEvent(start)
    this_replay = Replay(packets, longest, port, pace, load, observers, event, limit_s)
    if port.kind is not Kind.LOOPBACK and shows_progress():
        observers.append(ProgressLine(this_replay.tally))
    summary: dict[str, Any] = {
        "file": str(file),
        "speed": "max" if pace is Pace.MAX else factor,
        "left_out": traffic.left_out,
        **this_replay.play(),
        "far_end": view.counters(),
    }
    _print(summary, replay_lines(summary), summary_file, as_json)
    for error in (summary["error"], why_nothing_sent(summary, "packets")):
        if error is not None:
            raise RunError(error)
    # --loop has no other end than Ctrl-C.
    return int(has_failed(this_replay.tally, summary["interrupted"] and not loop, failures))


def _check_port(traffic: Traffic, port: PortSpec, speed: float, keeps_time: bool) -> float:
    """Load of the packets on the link, as a fraction.

    Raises:
        InputError: packets of another kind of link, or too many.
    """
    from lidar_emu.transports.frames import unpack_frames
    from lidar_emu.transports.spec import Kind, time_on_link_s

    if traffic.is_can != (port.kind is Kind.CAN):
        what, options = (
            ("CAN frames", "--interface and --channel") if traffic.is_can else ("bytes", "--port PORT")
        )
        raise InputError("replay", None, Finding(f"{what} for {port}"), f"pass {options}")
    if traffic.recording is None:
        require_port(port, "replay")
    frames = (f for _, payload in traffic.packets for f in unpack_frames(payload))
    if traffic.is_can and not port.fd and any(frame.is_fd for frame in frames):
        raise InputError("replay", None, Finding("CAN FD frames for a classic bus"), "pass --fd to send them")
    if not (keeps_time and traffic.span_ns):
        return 0.0
    busy_s = sum(time_on_link_s(port, payload) for _, payload in traffic.packets[:-1])
    load = speed * busy_s / (traffic.span_ns * 1e-9)
    if load > 1:
        found = Finding(f"packets need {100 * load:.0f} % of {port}")
        raise InputError("replay", None, found, "use a faster link, or a lower --speed")
    return load


def _compare(file: Path, summary_file: str | None, as_json: bool) -> int:
    from lidar_emu.cli.run_lines import comparison_lines
    from lidar_emu.recording.read import read_recording
    from lidar_emu.recording.recompute import recompute

    with busy(PREPARING):
        comparison = recompute(read_recording(file)).to_json()
    _print(comparison, comparison_lines(comparison), summary_file, as_json)
    return int(comparison["different"] > 0)


def _write(file: Path, to: Path, from_s: float | None, until_s: float | None) -> None:
    from lidar_emu.recording.traffic import check_wire_file, read_traffic, write_wire_file

    check_keeps(file, to, "--to")
    check_wire_file(to)
    with busy(f"reading {file}"):
        traffic = read_traffic(file, as_sent=True).within(from_s, until_s)
        line = write_wire_file(traffic, to)
    print_line(line)


def _print(summary: dict[str, Any], lines: list[str], summary_file: str | None, as_json: bool) -> None:
    if as_json:
        print_line(json.dumps(summary))
    else:
        print_lines(lines)
    if summary_file is not None:
        write_text(Path(summary_file), json.dumps(summary, indent=2) + "\n")


def _port_option(port: PortSpec) -> dict[str, str | None]:
    from lidar_emu.transports.spec import Kind

    return {"--port": None if port.kind is Kind.LOOPBACK else str(port)}


def _reject(option: str, others: dict[str, Any]) -> None:
    for name, value in others.items():
        if value is not None:
            raise InputError(name, None, value, f"cannot be combined with {option}")
