"""`lidar-emu check` on lines of which the test knows what they do."""

from __future__ import annotations

import json
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from programs import Program

from lidar_emu.bench import link_check
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.scenario.load import load
from lidar_emu.transports.opening import ByteHost
from lidar_emu.transports.sockets import open_stream_host
from lidar_emu.transports.spec import parse_port

Start = Callable[..., Program]
Echo = Callable[[Callable[[int, bytes], bytes]], str]

NEVER_LATE = ["--set", "timing.late_after_s=100"]
SHORT = ["--duration", "2", "--json", *NEVER_LATE]


@pytest.fixture
def plug() -> Iterator[Echo]:
    """An adapter whose plug returns a function of the number of bytes before, and of the bytes."""
    servers: list[socket.socket] = []
    threads: list[threading.Thread] = []

    def serve(server: socket.socket, change: Callable[[int, bytes], bytes]) -> None:
        connection, _ = server.accept()
        before = 0
        with connection:
            while data := connection.recv(4096):
                connection.sendall(change(before, data))
                before += len(data)

    def make(change: Callable[[int, bytes], bytes]) -> str:
        server = socket.create_server(("127.0.0.1", 0))
        servers.append(server)
        threads.append(threading.Thread(target=serve, args=(server, change)))
        threads[-1].start()
        return f"socket://127.0.0.1:{server.getsockname()[1]}"

    yield make
    for thread in threads:
        thread.join()
    for server in servers:
        server.close()


def damaged(before: int, data: bytes) -> bytes:
    """Bit 3 of one byte in 700 is wrong: each packet has fewer bytes, and no two damages."""
    return bytes(byte ^ 8 if (before + k) % 700 == 350 else byte for k, byte in enumerate(data))


def checked(start: Start, *arguments: str) -> tuple[int, dict[str, Any]]:
    run = start("check", *arguments, *SHORT)
    code = run.wait()
    return code, json.loads(run.out)


def test_a_plug_that_returns_everything_fits(start: Start, plug: Echo) -> None:
    fault = "faults=[{kind: bit_errors, rate: 0.001}]"  # of the scenario, not of the cable
    code, report = checked(start, "--port", plug(lambda _, data: data), "--set", fault)
    assert code == 0
    assert report["fits"]
    assert report["problems"] == []
    assert report["due"] == report["sent"] == report["arrived"] == 40
    assert report["damaged"] == report["skipped_bytes"] == report["commands"] == 0
    assert (
        report["transit"]["count"]
        == report["lateness"]["count"]
        == sum(report["histogram"]["lateness"])
        == 40
    )
    assert report["wire_load"] == 0


def test_damaged_bytes_are_counted(start: Start, plug: Echo) -> None:
    code, report = checked(start, "--port", plug(damaged))
    assert code == 1
    hit = (40 * 158 - 350) // 700 + 1
    assert 40 - hit <= report["arrived"] <= 40 - hit + 2, (
        "a delimiter that is hit leaves both its packets whole"
    )
    assert any("did not arrive" in problem for problem in report["problems"])
    assert report["transit"]["count"] == 0


def test_a_plug_that_returns_nothing_does_not_fit(start: Start, plug: Echo) -> None:
    run = start("check", "--port", plug(lambda _, __: b""), "--duration", "1", *NEVER_LATE)
    assert run.wait() == 1
    assert "it does not fit: 20 of 20 packets did not arrive" in run.out


@pytest.mark.parametrize("port", ["pty", "unix"])
def test_two_ends_answer_commands(start: Start, port: str) -> None:
    ends = ["--port", "pty:lidar", "--port", "lidar"] if port == "pty" else ["--port", "unix:lidar"] * 2
    code, report = checked(start, *ends)
    assert code == 0, report["problems"]
    assert report["arrived"] == 40
    assert report["commands"] == report["turnaround"]["count"] > 10
    assert report["turnaround"]["p50_ns"] > report["transit"]["p50_ns"] > 0


def test_a_command_under_way_at_the_end_is_waited_for(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The device's end is found finished while the host's writes a command, and the write takes long."""
    is_written_out, is_writing = threading.Event(), threading.Event()
    commands_after_it: list[bytes] = []
    finished = PortRunner.finished.fget
    assert finished is not None

    def finished_in_a_write(port: PortRunner) -> bool:
        if finished(port):
            is_written_out.set()
        return is_writing.is_set()

    class SlowHost(ByteHost):
        def write(self, payload: bytes) -> bool:
            if is_written_out.is_set():
                commands_after_it.append(payload)
            if len(commands_after_it) == 2:  # every packet was read before it
                is_writing.set()
                threading.Event().wait(0.3)
            return super().write(payload)

    monkeypatch.setattr(link_check, "open_host", lambda spec: SlowHost(lambda: open_stream_host(spec)))
    monkeypatch.setattr(PortRunner, "finished", property(finished_in_a_write))
    port = parse_port(f"unix:{tmp_path}/lidar")
    report = link_check.check_link(load("descent.yaml"), [port, port], 0.1, lambda _: None)
    assert len(commands_after_it) == 2
    assert report.commands == len(report.turnaround_ns) > 2
    assert report.arrived == 2


def test_another_interface_and_format_are_checked_as_well(start: Start) -> None:
    ends = ["--port", "pty:lidar", "--port", "lidar", "--serial-format", "8E2"]
    code, report = checked(start, *ends, "--set", "wire.interface=altimeter", "--set", "wire.pty_uart=true")
    assert code == 0, report["problems"]
    assert report["arrived"] == 40
    assert report["commands"] == report["turnaround"]["count"] > 0
    length = int(report["packet"].removesuffix(" bytes"))
    assert report["wire_load"] == pytest.approx(20 * length * 12 / 115_200)
    assert report["transit"]["p50_ns"] >= 1e9 * (length - 1) * 12 / 115_200


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--port", "pty"], "check: only pty; pass the other end too"),
        ([], "check: no port; pass --port PORT"),
        (["--port", "a", "--port", "b", "--port", "c"], "must be one port or two"),
        (["--port", "loop://", "--duration", "1e9"], "--duration: must be at most a day"),
        (["--port", "loop://", "--duration", "0"], "--duration: must be a number above 0"),
        (["--port", "nowhere"], "there is no such port"),
        (["--port", "pty", "--port", "pty", "--baud", "9600"], "need 329 % of the wire"),
    ],
)
def test_what_cannot_be_checked_is_refused_in_a_line(start: Start, arguments: list[str], said: str) -> None:
    run = start("check", *arguments)
    assert run.wait() == 2
    assert said in run.err
    assert run.err.count("\n") == 1


def test_ctrl_c_keeps_what_was_measured(start: Start) -> None:
    host = socket.create_server(("127.0.0.1", 0))
    run = start(
        "check", "--port", f"socket://127.0.0.1:{host.getsockname()[1]}", "--duration", "3600", "--json"
    )
    plug, _ = host.accept()
    for _ in range(5):  # the flight has begun
        plug.sendall(plug.recv(4096))
    run.signal(signal.SIGINT)
    run.wait()
    report = json.loads(run.out)
    assert report["interrupted"]
    assert report["arrived"] > 0
    assert report["sent"] < 3600 * 20
    plug.close()
    host.close()
