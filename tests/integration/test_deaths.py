"""One of a run's two processes dies or stands still: the other one notices, says so, and leaves nothing behind."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path

import handwritten
import pytest
import slcan_lines
from comparison import assert_equal
from mcap.reader import make_reader
from programs import FarEnd, Program, is_running, read_summary
from waiting import eventually

from lidar_emu.measurement import Measurement
from lidar_protocol import Housekeeping, Message, SerialReceiver, default_interface

Start = Callable[..., Program]
Simulated = Callable[..., Measurement]
PACKET_BYTES = 144
KEPT = ["--summary", "s.json", "--record", "r.mcap"]
SAFE = ["--set", "timing.when_process_dies=safe"]
SAFE_MODE = default_interface().enumerations["mode"]["safe"]
DIED = "lidar-emu: the port process ended (signal 9)\n"
ORPHANED = "lidar-emu: the model's process died: the run has ended"


def serial(far_end: FarEnd) -> list[str]:
    return ["--port", far_end.path, "--baud", "921600"]


def received(far_end: FarEnd) -> tuple[list[int], list[Housekeeping]]:
    """Numbers of the shots, and the housekeeping with mode safe, which nothing follows."""
    messages = SerialReceiver(default_interface()).receive(bytes(far_end.data))
    shots = [int(message.header["shot"] or 0) for message in messages if isinstance(message, Message)]
    housekeeping = [message for message in messages if isinstance(message, Housekeeping)]
    final = [message for message in housekeeping if message.values["mode"] == SAFE_MODE]
    assert messages[len(messages) - len(final) :] == final
    return shots, final


def assert_safe(words: list[Housekeeping]) -> None:
    (said,) = words
    assert (said.values["laser_on"], said.values["laser_power_w"]) == (False, 0.0)


@pytest.mark.parametrize("port", [[], ["--port", "pty"]])
def test_the_death_of_the_port_process_is_one_line_and_a_summary(
    port: list[str], start: Start, tmp_path: Path
) -> None:
    run = start("run", "descent.yaml", *port, *SAFE, *KEPT)
    process = run.port_process()
    run.word_after("descent on ")
    os.kill(process, signal.SIGKILL)
    assert run.wait() == 1
    assert run.err == DIED
    told = read_summary(tmp_path / "s.json")
    assert f"lidar-emu: {told['error']}\n" == DIED
    assert told["final_message"] == "not sent: the line ended with the port's process"


def test_a_run_whose_port_process_dies_keeps_what_was_flown(
    start: Start, far_end: FarEnd, simulated: Simulated, tmp_path: Path
) -> None:
    run = start("run", "descent.yaml", *serial(far_end), *KEPT)
    far_end.wait_for(10 * PACKET_BYTES)
    os.kill(run.port_process(), signal.SIGKILL)
    assert run.wait() == 1
    told = read_summary(tmp_path / "s.json")
    shots, words = received(far_end)
    assert words == []
    assert told["final_message"] is None
    # Between a write and its report there is a moment, in which a packet is sent of which nobody hears.
    assert told["shots"]["sent"] in (len(shots), len(shots) - 1)
    assert_equal(handwritten.rows(far_end.data), simulated("descent.yaml"))
    with (tmp_path / "r.mcap").open("rb") as stream:
        deliveries = [m.sequence for _, c, m in make_reader(stream).iter_messages() if c.topic == "/delivery"]
    assert deliveries == list(range(told["shots"]["due"]))
    assert sum(told["beams"][0].values()) == told["shots"]["due"]


def test_where_the_port_process_dies_the_model_says_that_the_device_is_safe(
    start: Start, far_end: FarEnd, tmp_path: Path
) -> None:
    run = start("run", "descent.yaml", *serial(far_end), *SAFE, *KEPT)
    far_end.wait_for(30 * PACKET_BYTES)
    os.kill(run.port_process(), signal.SIGKILL)
    assert run.wait() == 1
    assert run.err == DIED
    shots, words = received(far_end)
    assert_safe(words)
    assert words[0].values["time_ns"] == pytest.approx(50_000_000 * shots[-1], abs=60_000_000)
    told = read_summary(tmp_path / "s.json")
    assert told["final_message"] == "sent"
    assert "final message sent" in run.out


@pytest.mark.parametrize(("policy", "complaint"), [([], ""), (SAFE, ", final message sent")])
def test_where_the_model_dies_no_more_of_its_shots_are_sent(
    policy: list[str], complaint: str, start: Start, far_end: FarEnd
) -> None:
    run = start("run", "descent.yaml", *serial(far_end), *policy)
    process = run.port_process()
    far_end.wait_for(30 * PACKET_BYTES)
    run.process.kill()
    assert run.wait() == -signal.SIGKILL
    eventually(lambda: not is_running(process))
    assert run.err == f"{ORPHANED}{complaint}\n"
    shots, words = received(far_end)
    # Forty more were computed.
    assert shots == list(range(len(shots)))
    assert len(shots) <= 30 + 10
    if policy:
        assert_safe(words)
        assert words[0].values["shots_dropped"] == 0
    else:
        assert words == []


def test_final_message_on_can(start: Start, far_end: FarEnd) -> None:
    options = ["-i", "slcan", "-c", far_end.path, "--bitrate", "1000000"]
    run = start("run", "descent.yaml", *options, *SAFE)
    process = run.port_process()
    eventually(lambda: far_end.data.count(b"\r") > 200)
    run.process.kill()
    eventually(lambda: not is_running(process))
    run.wait()
    frames = slcan_lines.frames(far_end.data)
    database = slcan_lines.DATABASE
    health = [frame for frame in frames if database.get_message_by_frame_id(frame.can_id).name == "Health"]
    *before, final = (database.decode_message(frame.can_id, frame.data) for frame in health)
    assert (str(final["mode"]), int(final["laser_on"]), int(final["clock_locked"])) == ("safe", 0, 1)
    assert "safe" not in {str(values["mode"]) for values in before}


def test_an_interface_that_cannot_say_so(start: Start, far_end: FarEnd, tmp_path: Path) -> None:
    one_beam = ["--set", "wire.interface=altimeter", *SAFE]
    run = start("run", "descent.yaml", *serial(far_end), *one_beam, "--summary", "s.json")
    far_end.wait_for(100)
    os.kill(run.port_process(), signal.SIGKILL)
    assert run.wait() == 1
    why_no_final_message = "interface altimeter has no housekeeping with mode safe on this link"
    assert (
        run.err == f"lidar-emu: warning: {why_no_final_message}: nothing is sent where a process dies\n{DIED}"
    )
    assert read_summary(tmp_path / "s.json")["final_message"] == "none"


def test_an_orderly_end_says_nothing(start: Start, far_end: FarEnd) -> None:
    run = start("run", "descent.yaml", *serial(far_end), *SAFE)
    far_end.wait_for(5 * PACKET_BYTES)
    run.signal(signal.SIGINT)
    run.succeed()
    assert received(far_end)[1] == []


@pytest.mark.parametrize("who", ["port", "model"])
def test_a_process_that_stood_still_is_told_and_followed_by_no_burst(
    who: str, start: Start, far_end: FarEnd, tmp_path: Path
) -> None:
    """The port's for half a second; the model's for one second more than it is ahead."""
    fast = ["--set", "timing.rate_hz=100", "--set", "level=geometric", "--set", "site=flat"]
    run = start("run", "descent.yaml", "--duration", "5", *fast, *serial(far_end), *KEPT)
    process = run.port_process()
    far_end.wait_for(20 * PACKET_BYTES)
    if who == "port":
        run.stall(process, 0.5)
    else:
        run.stall(run.process.pid, 3.0)
    run.succeed()
    told = read_summary(tmp_path / "s.json")
    what = [event["what"] for event in told["process_events"]]
    texts = {"port": ["does not respond", "responds again"], "model": ["stalled"]}[who]
    process = {"port": "the port process", "model": "the model's process"}[who]
    assert all(any(f"{process} {text}" in line for line in what) for text in texts), what
    assert all(f": {line}" in run.out for line in what)
    shots, _ = received(far_end)
    assert (told["shots"]["due"], told["shots"]["sent"]) == (500, len(shots))
    assert told["shots"]["late"] == 500 - len(shots) >= {"port": 40, "model": 80}[who]
    # What was due meanwhile is not made up for: the longest lateness is far from the time that it stalled.
    assert told["lateness"]["max_ns"] < {"port": 250_000_000, "model": 1_500_000_000}[who]
    assert shots == sorted(set(shots))
