"""Hosts that flood the line, share it, never read it, or take it over: the run continues and reports it."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import handwritten
import pytest
from comparison import assert_complete, assert_equal
from programs import FarEnd, Program, listened_beams, read_summary
from waiting import LIMIT_S, eventually

from lidar_emu.measurement import Measurement
from lidar_protocol import Acknowledge, Host, SerialReceiver, default_interface

Start = Callable[..., Program]
Simulated = Callable[..., Measurement]
HOST = Host(default_interface())
RATE = [
    "descent.yaml", "--set", "timing.rate_hz=200", "--set", "level=geometric", "--set", "site=flat",
    "--set", "timing.late_after_s=60",  # however busy the machine is, no shot is skipped as late
    "--baud", "3000000", "--summary", "s.json",
]  # fmt: skip
PACKET_BYTES = 145


class Flood:
    """Writes without a pause for as long as somebody takes it, from a thread of its own."""

    def __init__(self, write: Callable[[bytes], Any], data: bytes) -> None:
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._pour, args=(write, data))
        self._thread.start()

    def _pour(self, write: Callable[[bytes], Any], data: bytes) -> None:
        while not self._over.is_set():
            try:
                write(data)
            except BlockingIOError:
                self._over.wait(0.001)

    def end(self) -> None:
        self._over.set()
        self._thread.join()


def accounted_for(summary: dict[str, Any]) -> bool:
    shots = summary["shots"]
    return (
        shots["due"]
        == summary["planned_shots"]
        == shots["sent"] + shots["late"] + sum(shots["dropped"].values())
    )


# The second is what costs a decoder most: each two bytes are a frame, and a bad one.
@pytest.mark.slow
@pytest.mark.parametrize("noise", [bytes(range(256)) * 16, b"\x05\x00" * 2048])
def test_a_flood_that_never_ends_does_not_keep_a_run_from_its_end(
    noise: bytes, start: Start, far_end: FarEnd, tmp_path: Path
) -> None:
    run = start("run", *RATE, "--duration", "3", "--port", far_end.path)
    far_end.wait_for(PACKET_BYTES)
    os.set_blocking(far_end.master, False)
    flood = Flood(lambda data: os.write(far_end.master, data), noise)
    run.succeed()
    flood.end()
    summary = read_summary(tmp_path / "s.json")
    assert accounted_for(summary)
    assert summary["shots"]["sent"] > 0
    # A line of 2.5 Mbit/s would have brought 0.75 MB, and the pty holds some more.
    assert 100_000 < summary["wire"]["received_bytes"] < 2_000_000
    assert summary["commands"]["skipped_bytes"] + summary["commands"]["ignored_bytes"] > 50_000


def test_two_hosts_on_one_line_are_heard_in_turn(start: Start, far_end: FarEnd, tmp_path: Path) -> None:
    run = start("run", *RATE, "--port", far_end.path)
    far_end.wait_for(PACKET_BYTES)
    first, foreign, second = (HOST.encode_command("set_pattern", sequence=k, pattern=0) for k in (40, 7, 41))
    far_end.send(first)
    far_end.send(foreign)  # of the other, which counts for itself
    far_end.send(second[:6] + second + second[6:])  # one sends in the middle of the other's command

    def verdicts() -> list[str]:
        messages = SerialReceiver(default_interface()).receive(bytes(far_end.data))
        return [message.verdict for message in messages if isinstance(message, Acknowledge)]

    assert eventually(lambda: verdicts() if len(verdicts()) == 3 else None) == [
        "accepted",
        "bad_sequence",
        "accepted",
    ]
    run.signal(signal.SIGINT)
    run.succeed()
    reported = read_summary(tmp_path / "s.json")["commands"]
    assert (reported["accepted"], reported["rejected"]) == (2, {"bad_sequence": 1})
    assert reported["skipped_bytes"] > 0


@pytest.mark.slow
def test_a_host_that_never_reads_costs_packets_and_no_more(start: Start, tmp_path: Path) -> None:
    master, slave = os.openpty()
    start("run", *RATE, "--duration", "2", "--port", os.ttyname(slave)).succeed()
    summary = read_summary(tmp_path / "s.json")
    assert accounted_for(summary)
    assert summary["shots"]["dropped"]["full"] > 100
    for descriptor in (master, slave):
        os.close(descriptor)


def test_a_port_that_another_program_sets_up_anew_is_taken_back(
    start: Start, far_end: FarEnd, tmp_path: Path
) -> None:
    run = start("run", *RATE, "--port", far_end.path)
    far_end.wait_for(PACKET_BYTES)
    # It may find them set back before it has looked, and complain.
    subprocess.run(["stty", "-F", far_end.path, "9600", "cooked", "echo"], check=False, capture_output=True)
    far_end.wait_for(len(far_end.data) + 100 * PACKET_BYTES)
    run.signal(signal.SIGINT)
    run.succeed()
    summary = read_summary(tmp_path / "s.json")
    reported = [event["what"] for event in summary["link_events"]]
    assert reported == ["another program has changed the settings of the port; they were set again"]
    assert "low_latency" in summary["missing"], "a pty has no driver that could"


@pytest.mark.slow
def test_a_descent_over_udp_for_a_listener_and_for_nobody_else(
    start: Start, simulated: Simulated, tmp_path: Path
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = f"udp:{free.getsockname()[1]}"
    listener = start("listen", "--port", port, "--json")
    listener.word_after("listening on ")
    start("run", "descent.yaml", "--port", port, "--duration", "3", "--summary", "s.json").succeed()
    summary = read_summary(tmp_path / "s.json")
    eventually(lambda: len(listened_beams(listener)) >= 4 * summary["shots"]["sent"])
    listener.signal(signal.SIGINT)
    assert listener.wait() == 0
    rows = listened_beams(listener)
    assert_complete(rows, summary, 4)
    assert_equal(rows, simulated("descent.yaml"))


def test_a_bridge_gets_one_framed_packet_a_datagram(start: Start, tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bridge:
        bridge.bind(("127.0.0.1", 0))
        bridge.settimeout(LIMIT_S)
        run = start("run", *RATE[:-4], "--port", f"udp:{bridge.getsockname()[1]}", "--summary", "s.json")
        datagrams = [bridge.recv(2000) for _ in range(50)]
        bridge.close()
        run.signal(signal.SIGINT)
        run.succeed()
    assert {len(handwritten.unstuffed(datagram)) for datagram in datagrams} == {1}
    shots = [packet for datagram in datagrams for packet in handwritten.shots(datagram)]
    assert {len(packet) for packet in shots} == {PACKET_BYTES - 3}
    assert read_summary(tmp_path / "s.json")["shots"]["sent"] >= len(shots) > 40
