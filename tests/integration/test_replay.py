"""Recorded runs sent again and computed again: byte for byte, whatever came in while they were flown."""

from __future__ import annotations

import json
import math
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import slcan_lines
from programs import LONG_BENCH, CommandingHost, FarEnd, Program, read_summary
from waiting import LIMIT_S, eventually

from lidar_emu.recording import channels
from lidar_emu.recording.read import read_recording
from lidar_emu.trajectory.live_datagram import Truth
from lidar_protocol import Acknowledge, Message, SerialReceiver, default_interface

Start = Callable[..., Program]
INTERFACE = default_interface()
DOWN = (0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0)
SERIAL = ["--baud", "3000000"]
QUICK = ["--set", "level=geometric", "--set", "site=flat", "--set", "device.housekeeping_rate_hz=5"]


@pytest.fixture
def far_ends() -> Iterator[Callable[[], FarEnd]]:
    made: list[FarEnd] = []

    def make() -> FarEnd:
        made.append(FarEnd())
        return made[-1]

    yield make
    for each in made:
        each.close()


def recomputed(start: Start, tmp_path: Path, file: str = "r.mcap", code: int = 0) -> dict[str, Any]:
    """Summary of `replay --recompute`."""
    comparing = start("replay", file, "--recompute", "--json", "--summary", "compared.json")
    assert comparing.wait() == code, comparing.err
    reported = read_summary(tmp_path / "compared.json")
    assert json.loads(comparing.out) == reported
    return reported


@pytest.mark.slow
def test_the_same_bytes_again(start: Start, far_ends: Callable[[], FarEnd], tmp_path: Path) -> None:
    first, again = far_ends(), far_ends()
    run = ["run", "descent.yaml", *QUICK, "--duration", "2", "--record", "r.mcap"]
    start(*run, "--port", first.path, *SERIAL).succeed()
    replay = ["replay", "r.mcap", "--summary", "s.json", "--fail-on", "late,dropped"]
    start(*replay, "--port", again.path, *SERIAL).succeed()
    assert len(first.data) > 40 * 100
    assert bytes(again.data) == bytes(first.data), "shots, housekeeping, and their order"
    reported = read_summary(tmp_path / "s.json")
    assert reported["packets"] == {
        "due": 50, "sent": 50, "late": 0, "dropped": {"full": 0, "nobody_connected": 0, "broken": 0},
    }  # fmt: skip
    assert reported["lateness"]["count"] == 50
    assert reported["wire"]["sent_bytes"] == len(first.data)


@pytest.mark.slow
def test_parts_speeds_and_laps(start: Start, far_ends: Callable[[], FarEnd]) -> None:
    start("run", "descent.yaml", "--pace", "max", "--record", "r.mcap").succeed()

    def shots(*options: str) -> tuple[list[int], int]:
        """Numbers of the shots that arrive, and how many bytes are none."""
        far_end = far_ends()
        program = start("replay", "r.mcap", "--port", far_end.path, *SERIAL, *options)
        if "--loop" in options:
            far_end.wait_for(60 * 100)
            program.signal(signal.SIGINT)
        program.succeed()
        receiver = SerialReceiver(INTERFACE)
        messages = [m for m in receiver.receive(bytes(far_end.data)) if isinstance(m, Message)]
        return [m.shot for m in messages if m.shot is not None], receiver.counters.skipped_bytes

    assert shots("--speed", "max") == (list(range(1008)), 0)
    assert shots("--from", "10", "--until", "11", "--speed", "4") == (list(range(200, 220)), 0)
    looped, skipped = shots("--from", "49.5", "--until", "50", "--speed", "20", "--loop")
    assert looped[:30] == [*range(990, 1000)] * 3
    assert skipped == 0


def test_a_change_is_found_and_named(start: Start, tmp_path: Path) -> None:
    start("run", "descent.yaml", "--pace", "max", "--duration", "3", "--record", "r.mcap").succeed()
    assert recomputed(start, tmp_path) == {
        "packets": 60, "equal": 60, "different": 0, "not_compared": 0, "first": None, "changed": {},
    }  # fmt: skip
    data = (tmp_path / "r.mcap").read_bytes()
    assert data.count(b'"reflectance":0.2,') + data.count(b'"seed":1,') >= 1
    (tmp_path / "other.mcap").write_bytes(data.replace(b'"seed":1,', b'"seed":2,'))
    reported = recomputed(start, tmp_path, "other.mcap", code=1)
    assert reported["different"] > 50
    first = reported["first"]
    recorded = read_recording(tmp_path / "r.mcap").measurement()
    value = getattr(recorded, first["field"])[first["shot"], first["beam"]]
    assert first["recorded"] == pytest.approx(value, abs=0.01)
    assert first["recomputed"] != first["recorded"]
    shown = start("replay", "other.mcap", "--recompute")
    assert shown.wait() == 1
    assert (
        f"shot {first['shot']}, beam {first['beam']}, {first['field']}: recorded {first['recorded']}, "
        in shown.out
    )


@pytest.mark.slow
@pytest.mark.parametrize("begins", ["now", "on-command"])
def test_commands_are_followed_again(
    begins: str, start: Start, far_ends: Callable[[], FarEnd], tmp_path: Path
) -> None:
    far_end, again = far_ends(), far_ends()
    run = start("run", "descent.yaml", *QUICK, "--port", far_end.path, *SERIAL, "--record", "r.mcap", "--start", begins,
                *(f"--set=device.{key}" for key in ("start=boot", "boot_s=0.3", "self_test_s=0.3", "acquisition_s=0.2",
                                                    "warm_restart_s=0.2", "clock.drift_ppm=50")),
                "--set", "timing.rate_hz=100")  # fmt: skip
    host = CommandingHost(far_end)
    command = host.command
    host.wait_for_mode("standby")
    assert command("set_pattern", pattern=1) == "accepted"
    assert command("set_pattern", pattern=9) == "out_of_range"
    assert command("set_mode", mode="track") == "accepted"
    host.wait_for_shots(20)
    assert command("enable_beams", beams=0b0101) == "accepted"
    host.wait_for_shots(10)
    assert command("set_rate_hz", rate_hz=25) == "accepted"
    host.wait_for_shots(10)
    assert command("reset", restart="warm") == "accepted"
    host.wait_for_mode("standby")
    assert command("set_mode", mode="track") == "accepted"
    host.wait_for_shots(10)
    run.signal(signal.SIGINT)
    run.succeed()
    reported = recomputed(start, tmp_path)
    assert reported["different"] == 0, reported["first"]
    assert reported["equal"] > 100
    assert reported["not_compared"] <= 3
    start("replay", "r.mcap", "--port", again.path, *SERIAL, "--speed", "max").succeed()
    for kind in (Message, Acknowledge):
        receiver = SerialReceiver(INTERFACE)
        replayed = [m for m in receiver.receive(bytes(again.data)) if isinstance(m, kind)]
        assert replayed == host.all(kind)


ORDERS = (
    "{kind: dropout, beams: [2], lasts_s: 0.5}",
    "{kind: bit_errors, rate: 1.0e-3}",
    "{kind: stuck, lasts_s: 1}",
)


def test_faults_ordered_in_flight_are_had_again(
    start: Start, far_ends: Callable[[], FarEnd], tmp_path: Path
) -> None:
    far_end = far_ends()
    files = ["--control", "c", "--record", "r.mcap", "--summary", "s.json"]
    link = ["--port", far_end.path, "--baud", "921600", "--set", "timing.rate_hz=100"]
    run = start("run", *LONG_BENCH, *link, *files)
    eventually(lambda: far_end.data)
    for order in ORDERS:
        start("inject", "c", order).succeed()
    already = len(far_end.data)
    eventually(lambda: len(far_end.data) > already + 10_000)
    run.signal(signal.SIGINT)
    run.succeed()
    due = read_summary(tmp_path / "s.json")["shots"]["due"]
    reported = recomputed(start, tmp_path)
    assert reported["different"] == 0, reported["first"]
    assert len(read_recording(tmp_path / "r.mcap").json_messages(channels.INJECTED_FAULT)) == 3
    assert reported["equal"] + reported["not_compared"] == due
    assert reported["not_compared"] <= 3


@pytest.mark.slow
@pytest.mark.parametrize("pace", ["wall", "lockstep"])
def test_live_truth_is_used_again(pace: str, start: Start, tmp_path: Path) -> None:
    """With gaps that make truth stale, datagrams that are refused, a jump, and by the clock a time that goes back."""
    settings = ("listen=unix:truth.sock", "when_stale=invalid", "stale_after_s=0.05")
    run = start("run", "live.yaml", "--pace", pace, "--record", "r.mcap", "--set", "timing.rate_hz=100",
                *(f"--set=trajectory.{setting}" for setting in settings))  # fmt: skip
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        link.bind(str(tmp_path / "simulator.sock"))
        link.settimeout(LIMIT_S)
        _simulate(link, str(tmp_path / "truth.sock"), waits=pace == "lockstep")
    run.succeed()
    reported = recomputed(start, tmp_path)
    assert reported["different"] == 0, reported["first"]
    assert reported["equal"] > 100
    if pace == "wall":
        events = read_recording(tmp_path / "r.mcap").json_messages(channels.EVENT)
        assert "refused truth is believed" in "".join(event.values["what"] for event in events)


def _simulate(link: socket.socket, there: str, waits: bool) -> None:
    step_ns = 20_000_000
    for step in range(81):
        jump_m = 100.0 if step > 60 else 0.0
        place, speed = (jump_m, 0.0, 900 - 0.6 * step), (0.0, 0.0, -30.0)
        # Back by six steps: the third truth that is older than the newest one is believed.
        time_ns = (step - 6 * (step > 50 and not waits)) * step_ns
        truth = Truth(step, time_ns, place, speed, None, DOWN, (0, 0, 0), step == 80)
        if 30 <= step < 40 and not waits:
            eventually_sent(link, b"no truth", there)
        else:
            eventually_sent(link, truth.to_bytes(), there)
        if waits:
            link.recv(65536)
        else:
            pause(step_ns * 1e-9)


def eventually_sent(link: socket.socket, datagram: bytes, there: str) -> None:
    def taken() -> bool:
        with suppress(FileNotFoundError, ConnectionRefusedError):
            link.sendto(datagram, there)
            return True
        return False

    eventually(taken)


def pause(duration_s: float) -> None:
    threading.Event().wait(duration_s)


@pytest.mark.slow
def test_can_frames_come_again(start: Start, far_ends: Callable[[], FarEnd], tmp_path: Path) -> None:
    """Over slcan, whose lines are read by hand; and through candump's format."""
    first, second, third = far_ends(), far_ends(), far_ends()

    def bus(far_end: FarEnd) -> list[str]:
        return ["-i", "slcan", "-c", far_end.path, "--bitrate", "1000000"]

    shots_alone = ["--set", "device.housekeeping_rate_hz=0"]
    run = ["run", "descent.yaml", *shots_alone, "--pace", "max", "--duration", "2", "--record", "r.mcap"]
    start(*run, *bus(first)).succeed()
    start("replay", "r.mcap", *bus(second)).succeed()
    stated = start("replay", "r.mcap", "--to", "r.log")
    stated.succeed()
    assert stated.out == "r.log: 40 packets\n"
    start("replay", "r.log", *bus(third), "--speed", "2").succeed()
    frames = slcan_lines.frames(first.data)
    assert len(frames) == 40 * 15
    assert slcan_lines.frames(second.data) == frames
    assert slcan_lines.frames(third.data) == frames
    lines = (tmp_path / "r.log").read_text().splitlines()
    assert len(lines) == len(frames)
    assert recomputed(start, tmp_path)["equal"] == 40
    refused = start("replay", "r.mcap", "--port", "pty")
    assert refused.wait() == 2
    assert refused.err == "lidar-emu: replay: CAN frames for pty; pass --interface and --channel\n"
