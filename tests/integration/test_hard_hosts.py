"""A host commands the beams in flight, or floods the line: every shot is sent once, and follows commands."""

from __future__ import annotations

import math
import os
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from itertools import groupby, pairwise
from pathlib import Path

import pytest
from programs import CommandingHost, FarEnd, Program, read_summary
from waiting import eventually

from lidar_protocol import Acknowledge, Host, Message, default_interface

Start = Callable[..., Program]
FLAT = ["--set", "level=geometric", "--set", "site=flat", "--set", "timing.rate_hz=200"]
RATE = ["descent.yaml", *FLAT, "--baud", "3000000", "--summary", "s.json"]
HOST = Host(default_interface())
COMMANDS = b"".join(HOST.encode_command("set_pattern", sequence=k, pattern=k % 2) for k in range(256))


@pytest.mark.slow
@pytest.mark.parametrize("pace", ["wall", "max"])
def test_the_beams_are_drawn_in_at_one_shot(pace: str, start: Start, far_end: FarEnd, tmp_path: Path) -> None:
    duration = "6" if pace == "wall" else "40"
    run = start("run", *RATE, "--duration", duration, "--port", far_end.path, "--pace", pace)
    host = CommandingHost(far_end)
    far_end.wait_for(158 * 100)
    assert host.command("set_pattern", pattern=1) == "accepted"
    far_end.wait_for(len(far_end.data) + 158 * 100)
    assert host.command("set_pattern", pattern=0) == "accepted"
    run.succeed()
    shots = host.all(Message)
    numbers = [int(shot.header["shot"] or 0) for shot in shots]
    angles = [shot.beams[0]["beam_angle_deg"] for shot in shots]
    assert [angle for angle, _ in groupby(angles)] == [22.5, 7.5, 22.5]
    heights_m = [
        shot.beams[0]["range_m"] * math.cos(math.radians(shot.beams[0]["beam_angle_deg"])) for shot in shots
    ]
    for (n, above_m), (m, below_m) in pairwise(zip(numbers, heights_m, strict=True)):
        assert n < m, "every shot once, in order"
        assert 0.0 < (above_m - below_m) / (m - n) < 0.51, (
            "over a plane the height sinks steadily, at any angle"
        )
    reported = read_summary(tmp_path / "s.json")
    assert reported["commands"]["accepted"] == 2
    assert reported["commands"]["delay"]["count"] == (2 if pace == "wall" else 0)
    assert reported["shots"]["sent"] == len(shots) == reported["shots"]["due"] - reported["shots"]["late"]
    assert sum(reported["beams"][0].values()) == reported["shots"]["due"] == numbers[-1] + 1


PATIENT = ["--set", "timing.late_after_s=60"]  # however busy the machine is, no shot is skipped as late


@pytest.mark.slow
@pytest.mark.parametrize("patterns", [(0, 0), (0, 1)], ids=["that change nothing", "of the beams"])
def test_a_thousand_commands_a_second_are_answered_or_counted_and_no_shot_is_lost(
    patterns: tuple[int, int], start: Start, far_end: FarEnd, tmp_path: Path
) -> None:
    """Five commands after each of 200 shots a second."""
    run = start("run", *RATE, *PATIENT, "--port", far_end.path)
    host, sent = CommandingHost(far_end), list[bytes]()

    def send(name: str, **arguments: int) -> None:
        sent.append(HOST.encode_command(name, sequence=len(sent) % 256, **arguments))
        far_end.send(sent[-1])

    def has_answered_the_last() -> bool:
        return any(
            (answer.command, answer.sequence) == ("no_op", (len(sent) - 1) % 256)
            for answer in host.all(Acknowledge)
        )

    for shots in range(1, 601):
        eventually(lambda: len(host.all(Message)) >= shots)  # noqa: B023
        for pattern in (*patterns, *patterns, patterns[0]):
            send("set_pattern", pattern=pattern)
    while not has_answered_the_last():  # after a stall it may be refused, too
        send("no_op")
        enough = len(host.all(Message)) + 50
        eventually(lambda: has_answered_the_last() or len(host.all(Message)) >= enough)  # noqa: B023
    run.signal(signal.SIGINT)
    assert run.wait() == 0
    numbers = [shot.header["shot"] for shot in host.all(Message)]
    assert numbers == list(range(len(numbers)))
    summary = read_summary(tmp_path / "s.json")
    commands, shots_of = summary["commands"], summary["shots"]
    assert (shots_of["late"], sum(shots_of["dropped"].values())) == (0, 0)
    answers = host.all(Acknowledge)
    assert len(answers) == commands["accepted"] + sum(commands["rejected"].values())
    assert len(answers) > 1000, "what a second brings"
    length = {"set_pattern": len(sent[0]), "no_op": len(sent[-1])}
    refused = commands["skipped_bytes"] + commands["ignored_bytes"] + summary["wire"]["rx_overrun_bytes"]
    assert sum(length[answer.command] for answer in answers) + refused == sum(map(len, sent))


# The second is what costs a decoder most: each two bytes are a frame, and a bad one.
@pytest.mark.slow
@pytest.mark.parametrize(
    "noise", [bytes(range(256)) * 16, b"\x05\x00" * 2048, COMMANDS], ids=["noise", "bad frames", "commands"]
)
def test_a_flood_that_never_ends_does_not_keep_a_run_from_its_end(
    noise: bytes, start: Start, far_end: FarEnd, tmp_path: Path
) -> None:
    run = start("run", *RATE, *PATIENT, "--duration", "3", "--port", far_end.path)
    far_end.wait_for(145)
    os.set_blocking(far_end.master, False)
    over = threading.Event()

    def pour() -> None:
        while not over.is_set():
            with suppress(BlockingIOError):
                os.write(far_end.master, noise)
                continue
            over.wait(0.001)

    flood = threading.Thread(target=pour)
    flood.start()
    run.succeed()
    over.set()
    flood.join()
    summary = read_summary(tmp_path / "s.json")
    shots = summary["shots"]
    assert shots["due"] == summary["planned_shots"]
    assert shots["due"] == shots["sent"] + shots["late"] + sum(shots["dropped"].values())
    assert shots["sent"] > 0
    # A line of 2.5 Mbit/s would have brought 0.75 MB, and the pty holds some more.
    assert 100_000 < summary["wire"]["received_bytes"] < 2_000_000
    assert summary["commands"]["skipped_bytes"] + summary["commands"]["ignored_bytes"] > 50_000
