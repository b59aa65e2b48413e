"""A host commands the beams in flight: every shot is sent once, and follows the command from one shot on."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable
from itertools import groupby, pairwise
from pathlib import Path

import pytest
from programs import FarEnd, Program, read_summary
from waiting import eventually

from lidar_protocol import Acknowledge, Host, Message, SerialReceiver, default_interface

Start = Callable[..., Program]
HOST = Host(default_interface())
RATE = [
    "descent.yaml",
    "--set",
    "timing.rate_hz=200",
    "--set",
    "level=geometric",
    "--set",
    "site=flat",
    "--summary",
    "s.json",
]
LINK = ["--baud", "3000000"]


def command(name: str, sequence: int, **arguments: int) -> bytes:
    return HOST.encode_command(name, sequence=sequence, **arguments)


def received(far_end: FarEnd) -> tuple[list[Message], list[Acknowledge]]:
    messages = SerialReceiver(default_interface()).receive(bytes(far_end.data))
    return (
        [message for message in messages if isinstance(message, Message)],
        [message for message in messages if isinstance(message, Acknowledge)],
    )


def answers(far_end: FarEnd, count: int) -> list[Acknowledge]:
    eventually(lambda: len(received(far_end)[1]) >= count)
    return received(far_end)[1]


@pytest.mark.slow
@pytest.mark.parametrize("pace", ["wall", "max"])
def test_the_beams_are_drawn_in_at_one_shot(pace: str, start: Start, far_end: FarEnd, tmp_path: Path) -> None:
    run = start(
        "run",
        *RATE,
        "--duration",
        "6" if pace == "wall" else "40",
        "--port",
        far_end.path,
        *LINK,
        "--pace",
        pace,
    )
    far_end.wait_for(145 * 100)
    far_end.send(command("set_pattern", 0, pattern=1))
    (first,) = answers(far_end, 1)
    assert (first.command, first.sequence, first.verdict) == ("set_pattern", 0, "accepted")
    far_end.wait_for(len(far_end.data) + 145 * 100)
    far_end.send(command("set_pattern", 1, pattern=0))
    run.succeed()
    shots, (_, second) = received(far_end)
    assert second.verdict == "accepted"
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


def test_commands_that_cannot_be_followed_are_answered_and_counted(
    start: Start, far_end: FarEnd, tmp_path: Path
) -> None:
    run = start("run", *RATE, "--port", far_end.path, *LINK)
    far_end.wait_for(145)
    unknown = command("no_op", 9)
    for data in (
        b"noise\0\0\xff\0",
        command("no_op", 5),
        command("no_op", 5),
        command("set_pattern", 6, pattern=77),
        command("set_mode", 7, mode=2),
        unknown[:-3] + b"\x55" + unknown[-2:],  # damaged: neither followed nor answered
        command("no_op", 8),
    ):
        far_end.send(data)
    verdicts = [answer.verdict for answer in answers(far_end, 5)]
    assert verdicts == ["accepted", "bad_sequence", "out_of_range", "out_of_state", "accepted"]
    run.signal(signal.SIGINT)
    run.succeed()
    reported = read_summary(tmp_path / "s.json")["commands"]
    assert reported["accepted"] == 2
    assert reported["rejected"] == {"bad_sequence": 1, "out_of_range": 1, "out_of_state": 1}
    assert reported["skipped_bytes"] > 10
    assert "2 accepted, bad sequence 1" in run.out


@pytest.mark.slow
def test_a_flood_of_noise_changes_nothing_that_is_sent(start: Start, far_end: FarEnd, tmp_path: Path) -> None:
    run = start("run", *RATE, "--duration", "1", "--port", far_end.path, *LINK)
    far_end.wait_for(145)
    far_end.send(bytes(range(256)) * 400)
    run.succeed()
    shots, answered = received(far_end)
    assert answered == []
    reported = read_summary(tmp_path / "s.json")
    assert len(shots) == reported["shots"]["sent"] == 200 - reported["shots"]["late"]
    assert reported["wire"]["received_bytes"] == 102400
    heard = reported["commands"]["skipped_bytes"] + reported["commands"]["ignored_bytes"]
    assert heard + reported["wire"]["rx_overrun_bytes"] >= 100_000
