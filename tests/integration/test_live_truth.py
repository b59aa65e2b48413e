"""A simulator beside the program: in lockstep, with the clock, and as simulators go wrong."""

from __future__ import annotations

import math
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import handwritten
import pytest
from free_ports import free_udp_port
from programs import CommandingHost, FarEnd, Program, read_summary
from waiting import LIMIT_S, eventually

import lidar_emu
from lidar_emu.recording.read import read_recording
from lidar_emu.report.recorded_run import read_recorded_run
from lidar_emu.shots.model import build_model
from lidar_emu.trajectory.live_datagram import Answer, Truth, Verdict
from lidar_protocol import Acknowledge, Host, default_interface

Start = Callable[..., Program]
LISTEN = "trajectory.listen=unix:truth.sock"
FAST = ["live.yaml", "--set", LISTEN, "--set", "timing.rate_hz=100", "--summary", "s.json"]
DOWN = (0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0)
STEP_NS = 20_000_000


def truth(step: int, last: bool = False, speed_mps: float = 30.0) -> Truth:
    """Straight down from 900 m."""
    time_ns = step * STEP_NS
    up_m = 900 - speed_mps * time_ns * 1e-9
    return Truth(step, time_ns, (0, 0, up_m), (0, 0, -speed_mps), (0, 0, 0), DOWN, (0, 0, 0), last)


class Simulator:
    """The other end of the program's socket."""

    def __init__(self, folder: Path) -> None:
        self._there = folder / "truth.sock"
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(str(folder / "simulator.sock"))
        self.socket.settimeout(LIMIT_S)

    def send(self, datagram: bytes) -> None:
        """Once the program listens."""

        def taken() -> bool:
            with suppress(FileNotFoundError, ConnectionRefusedError):
                self.socket.sendto(datagram, str(self._there))
                return True
            return False

        eventually(taken)

    def ask(self, datagram: bytes) -> Answer:
        """Send, and wait for the (single) datagram of the answer."""
        self.send(datagram)
        return Answer.from_bytes(self.socket.recv(65536))


@pytest.fixture
def simulator(tmp_path: Path) -> Iterator[Simulator]:
    made = Simulator(tmp_path)
    yield made
    made.socket.close()


def fly_in_lockstep(
    simulator: Simulator, steps: int, nuisance: Callable[[int], list[bytes]] | None = None
) -> bytes:
    """The packets of the answers; nuisances before each truth must be answered, too."""
    sent = b""
    for step in range(steps + 1):
        for bad in nuisance(step) if nuisance else []:
            assert simulator.ask(bad).verdict is not Verdict.ACCEPTED
        answer = simulator.ask(truth(step, last=step == steps).to_bytes())
        assert (answer.verdict, answer.sequence, answer.time_ns) == (Verdict.ACCEPTED, step, step * STEP_NS)
        assert all(step == steps or packet.due_ns <= answer.time_ns for packet in answer.packets)
        sent += b"".join(packet.payload for packet in answer.packets)
    return sent


def test_lockstep_reports_what_truth_reports(start: Start, simulator: Simulator, tmp_path: Path) -> None:
    """Every shot between the first truth and the last, once; ranges against the cosine of a plane."""
    run = start("run", *FAST, "--pace", "lockstep", "--set", "level=geometric", "--set", "site=flat")
    packets = [
        handwritten.decoded(packet) for packet in handwritten.unstuffed(fly_in_lockstep(simulator, 50))
    ]
    run.succeed()
    assert [header["shot"] for header, _ in packets] == list(range(100))
    for header, row in ((header, row) for header, beams in packets for row in beams):
        up_m = 900 - 30 * header["time_ns"] * 1e-9
        cosine = math.cos(math.radians(row["beam_angle_deg"]))
        assert row["range_m"] == pytest.approx(up_m / cosine, abs=0.51e-3)
        assert row["closing_speed_mps"] == pytest.approx(30 * cosine, abs=0.51e-4)
    reported = read_summary(tmp_path / "s.json")
    assert reported["shots"]["sent"] == 100
    assert reported["truth"]["age"]["count"] == 0  # every shot lies between two truths


def test_lockstep_dates_what_the_host_sends_by_the_simulator(
    start: Start, simulator: Simulator, far_end: FarEnd, tmp_path: Path
) -> None:
    flight = [*FAST, "--pace", "lockstep", "--set", "level=geometric", "--set", "site=flat"]
    run = start("run", *flight, "--port", far_end.path, "--baud", "3000000", "--record", "r.mcap")
    host, sender = CommandingHost(far_end), Host(default_interface())
    fields = default_interface().commands.messages_by_name["navigation"].arguments  # type: ignore[union-attr]
    sent_at, step = 5, 0
    while not host.all(Acknowledge):
        if step == sent_at:
            far_end.send(sender.encode_message("navigation", sequence=1, **dict.fromkeys(fields, 1)))
            far_end.send(sender.encode_command("no_op", sequence=1))
        simulator.ask(truth(step, speed_mps=0.01).to_bytes())
        step += 1
    simulator.ask(truth(step, last=True, speed_mps=0.01).to_bytes())
    run.succeed()
    found = read_recording(tmp_path / "r.mcap").host_messages()
    assert found.sequence.tolist() == [1]
    assert sent_at * STEP_NS - STEP_NS <= found.time_ns[0] == found.device_ns[0] <= step * STEP_NS
    assert read_summary(tmp_path / "s.json")["host_messages"]["navigation"]["accepted"] == 1


def test_lockstep_answers_with_faulty_packets(start: Start, simulator: Simulator, tmp_path: Path) -> None:
    """Shots 20 to 29 are lost, those from 50 to 59 are 40 ms late; nobody waits for what does not come."""
    lost, late = (
        "{kind: lost, from_s: 0.2, to_s: 0.3}",
        "{kind: delayed, delay_s: 0.04, from_s: 0.5, to_s: 0.6}",
    )
    run = start("run", *FAST, "--pace", "lockstep", "--set", f"faults=[{lost}, {late}]")
    packets = handwritten.unstuffed(fly_in_lockstep(simulator, 50))
    run.succeed()
    shots = [handwritten.decoded(packet)[0]["shot"] for packet in packets]
    assert shots == [*range(20), *range(30, 100)]
    reported = read_summary(tmp_path / "s.json")
    assert reported["faults"] == {"shots": {"delayed": 10, "lost": 10}, "suppressed": 10, "held": 0}
    assert (reported["shots"]["due"], reported["shots"]["sent"]) == (100, 90)


def nuisances(step: int) -> list[bytes]:
    """What lossy links and broken simulators send between two good truths."""
    spoilt = truth(step)._replace(velocity_site_mps=(math.nan, 0.0, 0.0))
    late = [truth(step - 2).to_bytes()] if step >= 2 else []
    return [b"", b"LETR", bytes(152), spoilt.to_bytes(), *late]


def test_same_truth_same_packets_whatever_comes_between(
    start: Start, simulator: Simulator, tmp_path: Path
) -> None:
    options = [*FAST, "--pace", "lockstep", "--set", "level=spectral"]
    flown = []
    for nuisance in (None, nuisances):
        run = start("run", *options)
        flown.append(fly_in_lockstep(simulator, 15, nuisance))
        run.succeed()
    assert flown[0] == flown[1]
    assert len(handwritten.rows(flown[0])) == 4 * 30
    reported = read_summary(tmp_path / "s.json")["truth"]["datagrams"]
    assert (reported["malformed"], reported["not_finite"], reported["out_of_order"]) == (48, 16, 14)


def test_a_truth_that_comes_twice_is_answered_twice(start: Start, simulator: Simulator) -> None:
    start("run", *FAST, "--pace", "lockstep")
    assert simulator.ask(truth(0).to_bytes()).packets == ()
    first = simulator.ask(truth(3).to_bytes())
    again = simulator.ask(truth(3).to_bytes())
    assert first == again
    assert len(first.packets) == 6


def test_a_repeat_with_the_flag_of_the_last_truth_ends_it(start: Start, simulator: Simulator) -> None:
    """A simulator learns afterwards that it had sent its last truth: what was not due yet is in that answer."""
    run = start("run", *FAST, "--pace", "lockstep", "--set", "timing.processing_latency_s=0.025")
    simulator.ask(truth(0).to_bytes())
    sent = [packet.shot for packet in simulator.ask(truth(3).to_bytes()).packets]
    answer = simulator.ask(truth(3, last=True)._replace(sequence=4).to_bytes())
    assert (answer.verdict, answer.sequence, answer.time_ns) == (Verdict.ACCEPTED, 4, 3 * STEP_NS)
    assert (sent, [packet.shot for packet in answer.packets]) == ([0, 1, 2, 3], [4, 5])
    run.succeed()


def test_lockstep_starts_where_truth_starts(start: Start, simulator: Simulator) -> None:
    start("run", *FAST, "--pace", "lockstep")
    simulator.ask(truth(100).to_bytes())
    assert [packet.shot for packet in simulator.ask(truth(102).to_bytes()).packets] == [200, 201, 202, 203]


def test_the_clock_waits_for_no_truth(start: Start, simulator: Simulator, tmp_path: Path) -> None:
    """Two truths, then silence: the motion goes on, and that is reported."""
    run = start("run", *FAST, "--duration", "0.5", "--set", "level=geometric")
    simulator.send(truth(0).to_bytes())
    simulator.send(truth(1).to_bytes())
    run.succeed()
    reported = read_summary(tmp_path / "s.json")
    shots, age = reported["shots"], reported["truth"]["age"]
    assert shots["sent"] + shots["late"] == shots["due"] == reported["planned_shots"] == 50
    # A shot that is late, beside a busy neighbour, is not computed.
    assert reported["truth"]["stale_shots"] + shots["late"] >= 37
    assert 0.47e9 - shots["late"] * 10e6 <= age["max_ns"] * 1.02
    assert age["max_ns"] <= 0.48e9
    # Coasting along a straight line is exact: the error is the wire's, and that of the digits of a time.
    assert reported["range_error_m"]["max"] == 0
    assert reported["truth"]["response"]["count"] == shots["sent"]


def test_stale_truth_can_end_a_run(start: Start, simulator: Simulator, tmp_path: Path) -> None:
    run = start("run", *FAST, "--set", "trajectory.when_stale=abort")
    simulator.send(truth(0).to_bytes())
    assert run.wait() == 1
    assert "truth is stale" in run.err
    assert len(run.err.splitlines()) == 1
    reported = read_summary(tmp_path / "s.json")
    assert "truth is stale" in reported["error"]
    age = reported["truth"]["age"]
    assert 5 <= age["count"] <= 10
    assert age["max_ns"] <= 100_000_000  # stale_after_s


def test_ctrl_c_while_truth_is_awaited(start: Start, tmp_path: Path) -> None:
    run = start("run", *FAST)
    run.word_after("waits for ")
    assert (tmp_path / "truth.sock").exists()
    run.signal(signal.SIGINT)
    run.succeed()
    assert not (tmp_path / "truth.sock").exists()
    assert read_summary(tmp_path / "s.json")["shots"]["due"] == 0


def test_the_address_of_a_dead_program_is_taken_over_and_that_of_a_living_one_is_not(
    start: Start, tmp_path: Path
) -> None:
    killed = start("run", *FAST)
    killed.word_after("waits for ")
    killed.signal(signal.SIGKILL)
    killed.wait()
    assert (tmp_path / "truth.sock").exists()
    second = start("run", *FAST)
    second.word_after("waits for ")
    third = start("run", *FAST)
    assert third.wait() == 2
    assert "trajectory: listen: must be a free address" in third.err
    assert "(got 'unix:truth.sock')" in third.err
    assert len(third.err.splitlines()) == 1


def test_a_stranger_ends_no_flight(start: Start, simulator: Simulator, tmp_path: Path) -> None:
    """Flag 2 of another socket counts for nothing; the one that flew the vehicle ends the flight, and is named."""
    run = start("run", *FAST, "--set", "level=geometric", "--record", "r.mcap")
    simulator.send(truth(0).to_bytes())
    run.word_after("starts at ")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as stranger:
        stranger.bind(str(tmp_path / "stranger.sock"))
        for step in (1, 2):
            stranger.sendto(truth(step, last=True).to_bytes(), str(tmp_path / "truth.sock"))
    run.word_after("stranger.sock is ignored")
    simulator.send(truth(3, last=True).to_bytes())
    run.succeed()
    reported = read_summary(tmp_path / "s.json")["truth"]
    assert reported["ignored"] == 2
    assert reported["ended_by"].endswith("simulator.sock")
    ignored, ended = (event["what"] for event in reported["truth_events"])
    assert "stranger.sock is ignored" in ignored
    assert ended.endswith("simulator.sock ended the flight")
    recorded = read_recorded_run(read_recording(tmp_path / "r.mcap")).events
    assert [(event.values["of"], event.values["what"]) for event in recorded] == [
        ("truth", ignored),
        ("truth", ended),
    ]


def test_a_truth_dated_ahead_freezes_no_flight(start: Start, simulator: Simulator, tmp_path: Path) -> None:
    run = start("run", *FAST, "--set", "level=geometric")
    for step in range(6):
        simulator.send(truth(step).to_bytes())
        if step == 1:
            simulator.send(truth(450).to_bytes())
    simulator.send(truth(6, last=True).to_bytes())
    run.succeed()
    counts = read_summary(tmp_path / "s.json")["truth"]["datagrams"]
    assert (counts["accepted"], counts["implausible_time"], counts["out_of_order"]) == (7, 1, 0)


def test_other_machines_are_warned_about(start: Start) -> None:
    listen = f"trajectory.listen=udp:0.0.0.0:{free_udp_port()}"
    run = start("run", "live.yaml", "--set", listen, "--set", "trajectory.allow=[127.0.0.1]")
    run.word_after("waits for ")
    run.signal(signal.SIGINT)
    assert run.wait() == 0
    assert "is open to other machines" in run.err


def test_a_plan_of_a_flight_to_come_leaves_out_only_what_it_cannot_need() -> None:
    rows: list[dict[str, Any]] = build_model(lidar_emu.load("live.yaml")).plan.rows()
    left_out = {row["stage"] for row in rows if not row["computed"]}
    assert left_out == {"extinction", "ground altitude", "curvature of motion"}
    (curvature,) = (row for row in rows if row["stage"] == "curvature of motion")
    assert "for each m/s³ of jerk" in curvature["bound"]
