"""One of a run's two processes dies or stalls: the other one detects and reports it, and leaves nothing behind."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable
from pathlib import Path

import handwritten
import pytest
import slcan_lines
from comparison import assert_equal
from mcap.reader import make_reader
from programs import FarEnd, Program, is_running, longest_sequence, read_summary
from waiting import eventually

from lidar_emu.measurement import Measurement
from lidar_protocol import Housekeeping, Message, SerialReceiver, default_interface

Start = Callable[..., Program]
Simulated = Callable[..., Measurement]
PACKET_BYTES = 145
KEPT = ["--summary", "s.json", "--record", "r.mcap"]
SAFE = ["--set", "timing.when_process_dies=safe"]
SAFE_MODE = default_interface().enumerations["mode"]["safe"]
DIED = "lidar-emu: the port process ended (signal 9)\n"
ORPHANED = "lidar-emu: the model process died: the run has ended"


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
    (final,) = words
    assert (final.values["laser_on"], final.values["laser_power_w"]) == (False, 0.0)


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
    summary = read_summary(tmp_path / "s.json")
    assert f"lidar-emu: {summary['error']}\n" == DIED
    assert summary["final_message"] == "not sent: the line ended with the port process"


def test_a_run_whose_port_process_dies_keeps_what_was_flown(
    start: Start, far_end: FarEnd, simulated: Simulated, tmp_path: Path
) -> None:
    run = start("run", "descent.yaml", *serial(far_end), *KEPT)
    far_end.wait_for(10 * PACKET_BYTES)
    os.kill(run.port_process(), signal.SIGKILL)
    assert run.wait() == 1
    summary = read_summary(tmp_path / "s.json")
    shots, words = received(far_end)
    assert words == []
    assert summary["final_message"] is None
    # Between a write and its report there is a moment, in which a packet is sent of which nobody hears.
    assert summary["shots"]["sent"] in (len(shots), len(shots) - 1)
    assert_equal(handwritten.rows(far_end.data), simulated("descent.yaml"))
    with (tmp_path / "r.mcap").open("rb") as stream:
        deliveries = [m.sequence for _, c, m in make_reader(stream).iter_messages() if c.topic == "/delivery"]
    assert deliveries == list(range(summary["shots"]["due"]))
    assert sum(summary["beams"][0].values()) == summary["shots"]["due"]


def state_of(pid: int) -> str:
    """One letter, as in ps: T for a stopped process, Z for a dead one."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["opening", "waiting", "flying"])
def test_a_port_process_that_dies_while_the_model_is_stopped_leaves_a_summary(
    moment: str, start: Start, far_end: FarEnd, tmp_path: Path
) -> None:
    port = ["--port", "pty"] if moment == "waiting" else serial(far_end)
    run = start("run", "descent.yaml", *port, *KEPT)
    process = run.port_process()
    if moment == "waiting":
        run.word_after("descent on ")
    if moment == "flying":
        far_end.wait_for(10 * PACKET_BYTES)
    run.signal(signal.SIGSTOP)
    eventually(lambda: state_of(run.process.pid) == "T")
    os.kill(process, signal.SIGKILL)
    eventually(lambda: state_of(process) == "Z")
    run.signal(signal.SIGCONT)
    assert run.wait() == 1
    assert run.err == DIED
    summary = read_summary(tmp_path / "s.json")
    assert f"lidar-emu: {summary['error']}\n" == DIED
    if moment == "flying":
        with (tmp_path / "r.mcap").open("rb") as stream:
            deliveries = [
                m.sequence for _, c, m in make_reader(stream).iter_messages() if c.topic == "/delivery"
            ]
        assert deliveries == list(range(summary["shots"]["due"]))


def test_where_the_port_process_dies_the_model_states_that_the_device_is_safe(
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
    summary = read_summary(tmp_path / "s.json")
    assert summary["final_message"] == "sent"
    assert "final message sent" in run.out


@pytest.mark.slow
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
    assert run.err == f"lidar-emu: warning: {why_no_final_message}: nothing is sent if a process dies\n{DIED}"
    assert read_summary(tmp_path / "s.json")["final_message"] == "none"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("who", "stall_s", "skipped_s", "events"),
    [
        ("port", 0.5, 0.5, ["the port process does not respond", "the port process responds again"]),
        # The model is two seconds ahead at most.
        ("model", 3.0, 1.0, ["the model process stalled"]),
    ],
)
def test_a_stalled_process_is_reported_and_no_burst_follows(
    who: str,
    stall_s: float,
    skipped_s: float,
    events: list[str],
    start: Start,
    far_end: FarEnd,
    tmp_path: Path,
) -> None:
    fast = ["--set", "timing.rate_hz=100", "--set", "level=geometric", "--set", "site=flat"]
    run = start("run", "descent.yaml", *fast, *serial(far_end), *KEPT)
    port = run.port_process()
    far_end.wait_for(20 * PACKET_BYTES)
    if who == "port":
        run.stall(port, stall_s, until=lambda: events[0] in run.out)
    else:
        run.stall(run.process.pid, stall_s)
    eventually(lambda: events[-1] in run.out)
    far_end.wait_for(len(far_end.data) + 20 * PACKET_BYTES)
    run.signal(signal.SIGINT)
    run.succeed()
    summary = read_summary(tmp_path / "s.json")
    reported = [event["what"] for event in summary["process_events"]]
    assert all(any(line.startswith(event) for line in reported) for event in events), reported
    assert all(f": {line}" in run.out for line in reported)
    shots, _ = received(far_end)
    assert shots == sorted(set(shots))
    assert summary["shots"]["sent"] == len(shots)
    # What was due meanwhile is skipped, but for the first and the last shot.
    with (tmp_path / "r.mcap").open("rb") as stream:
        messages = make_reader(stream).iter_messages(topics=["/delivery"])
        deliveries = [json.loads(message.data) for _, _, message in messages]
    late = [delivery["shot"] for delivery in deliveries if delivery["status"] == "late"]
    assert longest_sequence(late) >= skipped_s * 100 - 3
    assert summary["shots"]["late"] == len(late)
