"""A run on a serial line, at the pace of the clock: every shot arrives with the simulation's values."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import handwritten
import numpy as np
import pytest
from comparison import SERIAL_STEPS, assert_complete, assert_equal
from programs import FarEnd, Program, PtyReader, listened_beams, read_summary
from waiting import eventually

from lidar_emu.measurement import Measurement

BEAMS = 4
CUC_STEP_S = 2**-24
Start = Callable[..., Program]
Simulated = Callable[..., Measurement]


def listened(listener: Program, summary: dict[str, Any]) -> list[dict[str, Any]]:
    """The rows of `listen --json` once all have come; the listener is ended as by Ctrl-C."""
    shots, housekeeping = summary["shots"]["sent"], summary["housekeeping"]["sent"]
    eventually(lambda: len(listened_beams(listener)) >= BEAMS * shots)
    eventually(lambda: listener.out.count('"housekeeping"') >= housekeeping)
    listener.signal(signal.SIGINT)
    assert listener.wait() == 0
    sent = shots + housekeeping
    assert f"received: frames {sent}, messages {sent}, housekeeping {housekeeping}" in listener.err
    return listened_beams(listener)


def assert_times_equal(rows: list[dict[str, Any]], simulated: Measurement) -> None:
    expected_s = simulated.time_s[[row["shot"] for row in rows], [row["beam"] for row in rows]]
    # Time of the packet and offset of the beam are rounded one after the other.
    received_s = np.array([row["time_s"] for row in rows])
    np.testing.assert_allclose(received_s, expected_s, rtol=0, atol=CUC_STEP_S + 0.5e-6)


def test_what_listen_decodes_is_what_simulate_computes(
    start: Start, simulated: Simulated, tmp_path: Path
) -> None:
    listener = start("listen", "--port", "pty", "--json")
    path = listener.word_after("listening on ")
    run = start(
        "run", "descent.yaml", "--port", path, "--baud", "921600", "--duration", "3", "--summary", "s.json"
    )
    run.succeed()
    summary = read_summary(tmp_path / "s.json")
    rows = listened(listener, summary)
    assert_complete(rows, summary, BEAMS)
    assert_equal(rows, simulated("descent.yaml"))
    assert_times_equal(rows, simulated("descent.yaml"))
    assert {"unit", "shot", "beam", "time_s", *SERIAL_STEPS} <= rows[0].keys() <= {
        "unit", "packet_time_s", *simulated("descent.yaml").table()
    }  # fmt: skip


@pytest.mark.soak
def test_a_whole_descent_read_by_listen_and_by_hand(
    start: Start, far_end: FarEnd, simulated: Simulated, tmp_path: Path
) -> None:
    listener = start("listen", "--port", "pty", "--json")
    far_end.forward_to(listener.word_after("listening on "))
    arguments = ["--port", far_end.path, "--baud", "921600", "--summary", "s.json"]
    start("run", "descent.yaml", *arguments).succeed()
    summary = read_summary(tmp_path / "s.json")
    assert summary["planned_shots"] == len(simulated("descent.yaml")) == 1008
    assert summary["shots"]["sent"] > 900
    for rows in (listened(listener, summary), handwritten.rows(far_end.data)):
        assert_complete(rows, summary, BEAMS)
        assert_equal(rows, simulated("descent.yaml"))
    assert summary["wire"]["sent_bytes"] == len(far_end.data)
    assert summary["wire"]["load"] == pytest.approx(20 * 145 * 10 / 921_600, rel=0.01)


def test_headers_read_by_hand(start: Start, far_end: FarEnd, simulated: Simulated) -> None:
    start("run", "descent.yaml", "--port", far_end.path, "--pace", "max", "--set", "wire.unit=3").succeed()
    headers = [handwritten.decoded(packet)[0] for packet in handwritten.shots(far_end.data)]
    expected = simulated("descent.yaml")
    assert [header["shot"] for header in headers] == expected.shot.tolist()
    for name in ("time_ns", "due_ns"):
        column = expected.due_ns if name == "due_ns" else expected.time_ns[:, 0]
        received = np.array([header[name] for header in headers])
        np.testing.assert_allclose(received, column, rtol=0, atol=0.5e9 * CUC_STEP_S + 0.5, err_msg=name)
    for header in headers:
        assert header["apid"] == 0x2A3
        assert header["sequence_count"] == header["shot"] % 2**14
        assert (header["interface_version"], header["mode"]) == (2, 4)
        assert header["laser_on"]
        assert header["clock_locked"]


def test_beams_fired_in_turn_have_times_of_their_own(
    start: Start, far_end: FarEnd, simulated: Simulated
) -> None:
    arguments = ["--duration", "3", "--set", "scanner.firing=in_turn", "--pace", "max"]
    start("run", "descent.yaml", "--port", far_end.path, *arguments).succeed()
    rows = handwritten.rows(far_end.data)
    expected = simulated("descent.yaml", duration_s="3", scanner__firing="in_turn")
    assert len(rows) == BEAMS * len(expected)
    assert_equal(rows, expected)
    # One cycle of three segments of 300 us after another.
    assert [row["time_offset_s"] for row in rows[:BEAMS]] == [0.0, 0.0009, 0.0018, 0.0027]
    assert {(row["beam"], row["time_offset_s"]) for row in rows} == set(
        enumerate((0.0, 0.0009, 0.0018, 0.0027))
    )


@pytest.mark.slow
def test_a_run_makes_a_pty_and_waits_for_its_host(start: Start, simulated: Simulated, tmp_path: Path) -> None:
    arguments = ["--port", "pty", "--duration", "2", "--pace", "max", "--summary", "s.json"]
    run = start("run", "descent.yaml", *arguments, started=True)
    reader = PtyReader(run.word_after("descent on "))
    run.succeed()
    reader.close()
    summary = read_summary(tmp_path / "s.json")
    rows = handwritten.rows(reader.data)
    assert_complete(rows, summary, BEAMS)
    assert summary["shots"]["sent"] == 40
    assert_equal(rows, simulated("descent.yaml"))
    # A reader has read all: nothing was thrown away with the pty.
    assert summary["wire"]["sent_bytes"] == len(reader.data)
