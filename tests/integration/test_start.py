"""Runs that wait for their host, on a pseudo-terminal under a stable name and over TCP, or that `listen` awaits."""

from __future__ import annotations

import json
import os
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Thread

import handwritten
import numpy as np
import pytest
from comparison import SERIAL_STEPS, assert_complete, assert_equal
from programs import Program, PtyReader, is_running, listened_beams, read_summary
from waiting import eventually

from lidar_emu.measurement import Measurement

Start = Callable[..., Program]
Simulated = Callable[..., Measurement]

BEAMS = 4
SHORT = ["descent.yaml", "--duration", "1", "--set", "timing.late_after_s=60"]


def ready_port(run: Program) -> str:
    """The port of `run --json`, once it is ready."""
    return str(json.loads(eventually(lambda: run.out.partition("\n")[0]))["ready"]["port"])


@pytest.fixture
def server() -> Iterator[socket.socket]:
    """A TCP address on this machine that nobody listens at yet."""
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        yield bound


def read_all(listening: socket.socket, into: bytearray) -> None:
    """Accept one connection and read it to its end."""
    connection, _ = listening.accept()
    with connection:
        while data := connection.recv(65536):
            into.extend(data)


def test_a_host_that_opens_the_pty_receives_every_shot(
    start: Start, simulated: Simulated, tmp_path: Path
) -> None:
    link = tmp_path / "lidar"
    run = start("run", *SHORT, "--port", f"pty:{link}", "--json")
    assert ready_port(run) == str(link)
    assert link.is_symlink()
    reader = PtyReader(str(link))
    run.succeed()
    reader.close()
    summary = json.loads(run.out.splitlines()[-1])
    assert summary["shots"]["sent"] == 20
    assert summary["shots"]["dropped"] == {"full": 0, "nobody_connected": 0, "broken": 0}
    rows = handwritten.rows(reader.data)
    assert_complete(rows, summary, BEAMS)
    assert_equal(rows, simulated("descent.yaml"))
    assert not link.is_symlink()


def test_a_host_that_listens_over_tcp_later_receives_every_shot(
    start: Start, server: socket.socket, simulated: Simulated
) -> None:
    url = f"socket://127.0.0.1:{server.getsockname()[1]}"
    run = start("run", *SHORT, "--port", url, "--json")
    assert ready_port(run) == url
    server.listen()
    data = bytearray()
    reader = Thread(target=read_all, args=(server, data))
    reader.start()
    run.succeed()
    reader.join()
    assert json.loads(run.out.splitlines()[-1])["shots"]["sent"] == 20
    assert_equal(handwritten.rows(data), simulated("descent.yaml"))


@pytest.mark.parametrize("kind", ["pty", "tcp"])
def test_a_host_that_never_comes_is_one_line(kind: str, start: Start, server: socket.socket) -> None:
    port = "pty" if kind == "pty" else f"socket://127.0.0.1:{server.getsockname()[1]}"
    run = start("run", *SHORT, "--port", port, "--wait-limit", "0.2")
    assert run.wait() == 1
    named = run.word_after("descent on ")
    assert run.err == (
        f"lidar-emu: {named}: waited 0.2 s for a host to open it; --wait-limit S allows more\n"
    )
    assert run.out.count("\n") == 2


def test_a_host_that_comes_and_goes_loses_what_follows(start: Start, tmp_path: Path) -> None:
    run = start("run", *SHORT, "--port", "pty", "--summary", "s.json", "--fail-on", "dropped")
    host = os.open(run.word_after("descent on "), os.O_RDWR | os.O_NOCTTY)
    assert os.read(host, 1)
    os.close(host)
    assert run.wait() == 1
    shots = read_summary(tmp_path / "s.json")["shots"]
    assert shots["due"] == 20
    assert shots["sent"] > 0
    assert shots["dropped"]["nobody_connected"] > 0


def test_a_run_that_sent_nothing_fails_and_states_why(start: Start, tmp_path: Path) -> None:
    run = start("run", *SHORT, "--port", f"pty:{tmp_path}/lidar", "--start", "now")
    assert run.wait() == 1
    assert run.err == (
        f"lidar-emu: {tmp_path}/lidar: none of 20 shots was sent: 20 dropped (nobody connected 20)\n"
    )
    assert "0 sent" in run.out


def test_a_device_in_standby_sent_nothing_either(start: Start) -> None:
    run = start("run", *SHORT, "--pace", "max", "--set", "device.start=standby")
    assert run.wait() == 1
    assert run.err == "lidar-emu: in-memory loopback: none of 20 shots was sent: 20 not fired\n"


def test_a_link_that_a_killed_run_has_left_is_replaced(start: Start, tmp_path: Path) -> None:
    link = tmp_path / "lidar"
    run = start("run", *SHORT, "--port", f"pty:{link}", "--json")
    ready_port(run)
    port = run.port_process()
    os.kill(run.process.pid, signal.SIGSTOP)  # it would remove the link
    os.kill(port, signal.SIGKILL)
    run.process.kill()
    run.process.wait()
    eventually(lambda: not is_running(port))
    assert link.is_symlink()
    second = start("run", *SHORT, "--port", f"pty:{link}", "--json")
    reader = PtyReader(ready_port(second))
    second.succeed()
    reader.close()
    assert not link.is_symlink()


def test_a_replay_waits_for_its_host_too(start: Start) -> None:
    start("run", *SHORT, "--pace", "max", "--record", "r.mcap").succeed()
    replay = start("replay", "r.mcap", "--port", "pty", "--json")
    reader = PtyReader(ready_port(replay))
    replay.succeed()
    reader.close()
    summary = json.loads(replay.out.splitlines()[-1])
    assert summary["packets"]["sent"] == summary["packets"]["due"] > 20
    given_up = start("replay", "r.mcap", "--port", "pty", "--wait-limit", "0.2")
    assert given_up.wait() == 1
    assert "waited 0.2 s for a host to open it" in given_up.err


def test_what_listen_decodes_is_what_simulate_computes(
    start: Start, simulated: Simulated, tmp_path: Path
) -> None:
    listener = start("listen", "--port", "pty", "--json")
    link = ["--port", listener.word_after("listening on "), "--baud", "921600"]
    start("run", "descent.yaml", *link, "--duration", "3", "--summary", "s.json").succeed()
    summary, expected = read_summary(tmp_path / "s.json"), simulated("descent.yaml")
    shots, housekeeping = summary["shots"]["sent"], summary["housekeeping"]["sent"]
    eventually(lambda: len(listened_beams(listener)) >= BEAMS * shots)
    eventually(lambda: listener.out.count('"housekeeping"') >= housekeeping)
    listener.signal(signal.SIGINT)
    assert listener.wait() == 0
    sent = shots + housekeeping
    assert f"received: frames {sent}, messages {sent}, housekeeping {housekeeping}" in listener.err
    rows = listened_beams(listener)
    assert_complete(rows, summary, BEAMS)
    assert_equal(rows, expected)
    # Time of the packet and offset of the beam are rounded one after the other.
    times_s = expected.time_s[[row["shot"] for row in rows], [row["beam"] for row in rows]]
    np.testing.assert_allclose([row["time_s"] for row in rows], times_s, rtol=0, atol=2**-24 + 0.5e-6)
    assert {"unit", "shot", "beam", "time_s", *SERIAL_STEPS} <= rows[0].keys()
    assert rows[0].keys() <= {"unit", "packet_time_s", *expected.table()}
