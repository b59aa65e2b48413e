"""The cFS application of examples/cfs on the emulator's port: messages on the software bus, and commands from there.

The executive is not needed: cfs/cfe.c is a processor with this application alone. On NOS3 the port is a UART of hwlib.
"""

from __future__ import annotations

import math
import os
import shutil
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from comparison import SERIAL_STEPS, assert_equal
from line_programs import LineProgram, answer, bare_port, emulator, frame_of, line_program, received
from waiting import LIMIT_S, eventually

from lidar_emu import Measurement

REPOSITORY = Path(__file__).resolve().parents[2]
SOURCES = REPOSITORY / "examples/cfs/lidar_app/fsw/src"
STAND_IN = Path(__file__).with_name("cfs")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(shutil.which("cc") is None, reason="not installed: gcc")]
COMMAND, SEND_HK, HK, SHOT = 0x18C2, 0x18C3, 0x08C2, 0x08C3
NOOP, RESET_COUNTERS, SYNCHRONISE, SET_MODE, SET_PATTERN, SET_RATE = range(6)
TELEMETRY_HEADER, SHOT_PAYLOAD, BEAM = 16, struct.Struct("<qIB3x"), struct.Struct("<ddBBB5x")
OUT_OF_STATE, SELF_TEST, TRACK = 4, 2, 4
REFUSED, ACCEPTED, REJECTED, UNANSWERED = "event 3 ", "event 4 ", "event 5 ", "event 6 "
VERDICT_LOST = "event 9 "


class Housekeeping(NamedTuple):
    """The payload of the housekeeping message."""

    command_counter: int
    command_error_counter: int
    mode: int
    last_verdict: int
    shots: int
    shots_lost: int
    bad_frames: int
    accepted: int
    rejected: int
    unanswered: int
    temperature_degc: float


def message(message_id: int, body: bytes) -> str:
    """A message in hexadecimal, its body from the function code on."""
    return (struct.pack(">HHH", message_id, 0xC000, len(body) - 1) + body).hex()


def command(code: int, arguments: bytes = b"") -> str:
    return message(COMMAND, bytes([code, 0]) + arguments)


def published(app: LineProgram, message_id: int) -> list[bytes]:
    """Payloads of all messages of one kind."""
    messages = [bytes.fromhex(words[1]) for words in app.words(f"message {message_id:04x}")]
    assert all(len(each) == 7 + int.from_bytes(each[4:6], "big") for each in messages)
    return [each[TELEMETRY_HEADER:] for each in messages]


def housekeeping(app: LineProgram) -> Housekeeping:
    """What the application publishes when it is asked to."""
    before = len(published(app, HK))
    app.write(message(SEND_HK, bytes(2)))
    eventually(lambda: len(published(app, HK)) > before)
    return Housekeeping(*struct.unpack("<4B6If", published(app, HK)[-1]))


@pytest.fixture(scope="module", params=["lidar_port.c", "lidar_port_hwlib.c"])
def application(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The application as a program that reads ./lidar."""
    program: Path = tmp_path_factory.mktemp("cfs") / "lidar_app"
    warnings = ["-std=c99", "-Wall", "-Wextra", "-Werror"]
    folders = [SOURCES, STAND_IN, REPOSITORY / "examples", REPOSITORY / "protocol/lidar_protocol"]
    files = [SOURCES / "lidar_app.c", SOURCES / request.param, *STAND_IN.glob("*.c")]
    include = [f"-I{folder}" for folder in folders]
    build = ["cc", *warnings, '-DLIDAR_APP_PORT="lidar"', *include, *files, "-o", program]
    done = subprocess.run(build, capture_output=True, text=True, check=False, timeout=LIMIT_S)
    assert done.returncode == 0, done.stderr
    return program


@contextmanager
def flight(application: Path, folder: Path, *arguments: str) -> Iterator[LineProgram]:
    with emulator(folder, *arguments), line_program([application], folder) as app:
        yield app


def test_a_whole_recorded_descent(
    application: Path, recorded: Path, simulated: Measurement, tmp_path: Path
) -> None:
    replayed = "replay", str(recorded / "run.mcap"), "--speed", "max", "--baud", "921600"
    with flight(application, tmp_path, *replayed) as app:
        app.wait_for("exit")
    rows: list[dict[str, Any]] = []
    for payload in published(app, SHOT):
        _, shot, _ = SHOT_PAYLOAD.unpack_from(payload)
        for beam, values in enumerate(BEAM.iter_unpack(payload[SHOT_PAYLOAD.size :])):
            names = "range_m", "closing_speed_mps", "range_valid", "speed_valid", "reason"
            rows.append({"shot": shot, "beam": beam, **dict(zip(names, values, strict=True))})
    assert [row["shot"] for row in rows[::4]] == list(range(len(simulated)))
    steps = {name: SERIAL_STEPS[name] for name in ("range_m", "closing_speed_mps")}
    assert_equal(rows, simulated, steps, exact=("range_valid", "speed_valid", "reason"))


def test_commands_and_errors_show_in_housekeeping(application: Path, tmp_path: Path) -> None:
    """Shots 10 to 13 have a wrong CRC."""
    damage = "faults=[{kind: wrong_crc, from_s: 0.5, to_s: 0.7}]"
    with flight(application, tmp_path, "run", "descent.yaml", "--set", damage) as app:
        eventually(lambda: len(published(app, SHOT)) >= 12)
        commands = [
            (SYNCHRONISE, b""),
            (SET_PATTERN, bytes([1, *bytes(7)])),
            (SET_RATE, struct.pack("<d", 10)),
            (SET_MODE, bytes([SELF_TEST, *bytes(7)])),
        ]
        for answered, (code, arguments) in enumerate(commands, 1):
            app.write(command(code, arguments))
            eventually(lambda: len(app.words(ACCEPTED) + app.words(REJECTED)) == answered)  # noqa: B023
        for refused in (SET_RATE, struct.pack("<d", -1)), (SET_MODE, b""), (99, b""):
            app.write(command(*refused))
        app.wait_for(REFUSED, 3)
        seen = housekeeping(app)
        assert seen.command_error_counter == 3
        assert (seen.command_counter, seen.accepted, seen.rejected, seen.unanswered) == (4, 3, 1, 0)
        assert (seen.mode, seen.last_verdict) == (TRACK, OUT_OF_STATE)
        shots = [SHOT_PAYLOAD.unpack_from(each)[1] for each in published(app, SHOT)[: seen.shots]]
        assert {10, 11, 12, 13}.isdisjoint(shots)
        assert len(shots) >= 12
        # On a busy machine late shots are not sent.
        assert seen.shots_lost == shots[-1] - shots[0] + 1 - len(shots)
        assert 1 <= seen.bad_frames <= 4
        app.write(command(RESET_COUNTERS))
        assert housekeeping(app).command_counter == 0
        eventually(lambda: not math.isnan(housekeeping(app).temperature_degc))


def test_a_command_is_repeated_and_given_up(application: Path, tmp_path: Path) -> None:
    """A lidar that does not answer. While a command is pending no other one is accepted.

    The given-up command's number is used again; its late answer is none to the next command.
    """
    frame, mode = frame_of("set_pattern", 0, pattern=1), frame_of("set_mode", 0, mode="self_test")
    with bare_port(tmp_path) as device, line_program([application], tmp_path) as app:
        app.write(command(SET_PATTERN, bytes([1, *bytes(7)])))
        app.write(command(SYNCHRONISE))
        seen = [housekeeping(app) for _ in range(5)]
        assert received(device, 5 * len(frame)) == 5 * frame
        app.write(command(SET_MODE, bytes([SELF_TEST, *bytes(7)])))
        assert received(device, len(mode)) == mode
        os.write(device, answer("set_pattern", "accepted") + answer("set_mode", "out_of_state"))
        app.wait_for(REJECTED)
    assert [each.unanswered for each in seen] == [0, 0, 0, 0, 1]
    assert [each.command_error_counter for each in seen] == [1] * 5
    assert len(app.words(UNANSWERED)) == len(app.words(REFUSED)) == 1
    assert not app.words(ACCEPTED)


def test_a_lost_acknowledgement(application: Path, tmp_path: Path) -> None:
    """The repeat is out of turn, which does not say whether the lidar followed the command.

    An acknowledgement of another unit is none.
    """
    frame, no_op = frame_of("set_pattern", 0, pattern=1), frame_of("no_op", 1)
    with bare_port(tmp_path) as device, line_program([application], tmp_path) as app:
        app.write(command(SET_PATTERN, bytes([1, *bytes(7)])))
        assert received(device, len(frame)) == frame
        housekeeping(app)
        assert received(device, len(frame)) == frame
        os.write(device, answer("set_pattern", "accepted", unit=1) + answer("set_pattern", "bad_sequence"))
        app.wait_for(VERDICT_LOST)
        seen = housekeeping(app)
        app.write(command(SYNCHRONISE))
        assert received(device, len(no_op)) == no_op
    assert (seen.accepted, seen.rejected, seen.unanswered) == (0, 0, 1)


def test_a_port_that_is_not_there_ends_the_application(application: Path, tmp_path: Path) -> None:
    with line_program([application], tmp_path) as app:
        app.wait_for("exit 3")
    assert [words[1] for words in app.words("event")] == ["7"]
