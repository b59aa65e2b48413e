"""Viewers of a recording that is being written get what was simulated, and cannot disturb its run."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import foxglove_client
import numpy as np
import pytest
from click.testing import CliRunner
from foxglove_client import FoxgloveClient
from free_ports import free_tcp_port
from waiting import LIMIT_S, eventually

from lidar_emu import Measurement
from lidar_emu.cli import cli
from lidar_emu.errors import InputError
from lidar_emu.recording.read import read_recording

pytestmark = pytest.mark.slow
PIECES = 12
"""Each has fewer messages than a client may be behind."""


class GrowingFile:
    """A copy of a recording that gains the rest of it piece by piece."""

    def __init__(self, path: Path, whole: Path) -> None:
        self.path, self._data = path, whole.read_bytes()
        self._ends = np.linspace(0, len(self._data), PIECES + 1).astype(int).tolist()[1:]
        path.write_bytes(self._data[: self._ends[0]])

    def grow(self) -> bool:
        """Add a piece; False if there is none."""
        begin = self.path.stat().st_size
        end = next((end for end in self._ends if end > begin), begin)
        with self.path.open("ab") as file:
            file.write(self._data[begin:end])
        return end > begin

    def last_shot_ns(self) -> int:
        """When the last shot so far was valid."""
        recording = read_recording(self.path)
        return recording.epoch_ns + int(recording.measurement().time_ns[-1, 0])


@contextmanager
def served(growing: GrowingFile) -> Iterator[int]:
    """Port at which the recording is served."""
    port = free_tcp_port()
    view = [sys.executable, "-m", "lidar_emu", "view", str(growing.path), "--foxglove", "--port", str(port)]
    with subprocess.Popen(view, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == f"ws://127.0.0.1:{port}, until Ctrl-C\n"
            yield port
            assert process.poll() is None
        finally:
            process.send_signal(signal.SIGINT)
    assert process.returncode == 0


def receive_all(port: int, growing: GrowingFile) -> FoxgloveClient:
    """Receive until the recording is complete; each piece is added once the client has the one before."""
    client, expected_ns = FoxgloveClient(port), 0

    def is_complete() -> bool:
        nonlocal expected_ns
        if "/ground" not in client.messages:
            return False  # sent to a client that comes later, too: it has subscribed
        if expected_ns and not (client.messages["/tf"] and client.messages["/tf"][-1][0] >= expected_ns):
            return False
        has_grown = growing.grow()
        expected_ns = growing.last_shot_ns()
        return not has_grown

    asyncio.run(asyncio.wait_for(client.receive(is_complete), LIMIT_S))
    return client


@pytest.fixture
def growing(recorded: Path, tmp_path: Path) -> GrowingFile:
    return GrowingFile(tmp_path / "growing.mcap", recorded / "run.mcap")


def test_a_client_gets_what_was_simulated(growing: GrowingFile, simulated: Measurement) -> None:
    with served(growing) as port:
        client = receive_all(port, growing)
    epoch_ns = read_recording(growing.path).epoch_ns
    for beam in range(simulated.beam_count):
        row_of = {epoch_ns + time_ns: row for row, time_ns in enumerate(simulated.time_ns[:, beam].tolist())}
        for name, valid in (("range_m", simulated.range_valid), ("closing_speed_mps", simulated.speed_valid)):
            messages = client.messages[f"/beam_{beam}/{name}"]
            rows = [row_of[time_ns] for time_ns, _ in messages]
            assert rows == list(range(rows[0], len(simulated))), "all shots since the client came"
            assert len(rows) > 0.8 * len(simulated)
            expected = np.where(valid, getattr(simulated, name), np.nan)[rows, beam]
            np.testing.assert_array_equal([decoded.data for _, decoded in messages], expected)
    position_m = [decoded.transforms[0].transform.translation for _, decoded in client.messages["/tf"]]
    expected_m = simulated.position_site_m[-len(position_m) :]
    np.testing.assert_array_equal([(at.x, at.y, at.z) for at in position_m], expected_m)
    path = [pose.pose.position for pose in client.messages["/path"][-1][1].poses]
    np.testing.assert_array_equal([(at.x, at.y, at.z) for at in path], simulated.position_site_m[: len(path)])
    assert {decoded.msg for _, decoded in client.messages["/events"]} >= {"beam 0: valid"}


def test_clients_that_hang_flood_or_leave_disturb_no_other(
    growing: GrowingFile, simulated: Measurement
) -> None:
    with served(growing) as port, foxglove_client.connect(port) as hanging:
        foxglove_client.send_text(hanging, foxglove_client.subscription(list(range(1, 30))))
        foxglove_client.connect(port).close()
        flood = threading.Thread(target=flooding, args=(port,), daemon=True)
        flood.start()
        client = receive_all(port, growing)
    flood.join(LIMIT_S)
    assert (
        client.messages["/tf"][-1][1].transforms[0].transform.translation.z
        == simulated.position_site_m[-1, 2]
    )


def flooding(port: int) -> None:
    """Send what no client should, until the server closes the connection or 20 000 messages are sent."""
    with suppress(OSError), foxglove_client.connect(port) as connection:
        for number in range(20_000):
            foxglove_client.send_text(
                connection, '{"op": "no such thing", "of": ' + "9" * (number % 200) + "}"
            )


def test_a_viewer_that_is_killed_changes_nothing(tmp_path: Path, simulated: Measurement) -> None:
    """The run of a device in real time, of which a viewer is killed while a client is connected to it."""
    port = free_tcp_port()
    run = ["run", "descent.yaml", "--record", "run.mcap", "--view", f"foxglove:{port}", "--json"]
    with started(*run, folder=tmp_path) as process:
        client = FoxgloveClient(port)
        eventually(lambda: is_listening(port))
        asyncio.run(asyncio.wait_for(client.receive(lambda: len(client.messages["/tf"]) > 5), LIMIT_S))
        os.kill(viewer_of(process), signal.SIGKILL)
        eventually(lambda: not is_listening(port))
        shots = len(read_recording(tmp_path / "run.mcap").measurement())
        eventually(lambda: len(read_recording(tmp_path / "run.mcap").measurement()) > shots)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, errors
    assert f"viewer: ws://127.0.0.1:{port}\n" in errors
    assert "warning: the viewer failed" in errors
    recorded = read_recording(tmp_path / "run.mcap")
    assert recorded.is_whole
    measured = recorded.measurement()
    np.testing.assert_array_equal(measured.range_m, simulated.range_m[: len(measured)])


def test_a_run_that_fails_does_not_wait_for_its_viewer(tmp_path: Path) -> None:
    link = ["--port", f"tcp:{free_tcp_port()}", "--start", "on-connect", "--wait-limit", "0.1"]
    with started(
        "run", "bench.yaml", *link, "--view", f"foxglove:{free_tcp_port()}", folder=tmp_path
    ) as process:
        _, errors = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 1
    assert "the viewer" not in errors


@contextmanager
def started(*arguments: str, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A command whose temporary files are in a folder, and which ends with the context."""
    environment = {**os.environ, "TMPDIR": str(folder)}
    command = [sys.executable, "-m", "lidar_emu", *arguments]
    with subprocess.Popen(
        command, env=environment, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def test_a_viewer_ends_with_its_run(tmp_path: Path) -> None:
    port = free_tcp_port()
    with started("run", "bench.yaml", "--view", f"foxglove:{port}", folder=tmp_path) as process:
        eventually(lambda: is_listening(port))
        process.kill()
    eventually(lambda: not is_listening(port))


def is_listening(port: int) -> bool:
    try:
        foxglove_client.connect(port).close()
    except OSError:
        return False
    return True


def viewer_of(run: subprocess.Popen[str]) -> int:
    """Process of the viewer that a run has started."""
    children = Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()
    (viewer,) = [child for child in children if b"\0view\0" in Path(f"/proc/{child}/cmdline").read_bytes()]
    return int(viewer)


@pytest.mark.parametrize(
    ("arguments", "refusal"),
    [
        (("view", "{run}", "--foxglove"), "--foxglove: a complete recording; convert it: lidar-emu report"),
        (("run", "bench.yaml", "--view", "foxglove:{port}"), "--view: port {port}: "),
        *(
            (
                ("run", "bench.yaml", "--view", viewer),
                f"--view: must be window, web, foxglove, web:PORT or foxglove:PORT (got '{viewer}')",
            )
            for viewer in ("foxglove:0", "window:9000", "foxglove:65535")
        ),
        (("run", "bench.yaml", "--view", "foxglove", "--pace", "max"), "needs --pace wall or lockstep"),
        (("run", "--view", "bench.yaml"), "Missing argument 'SCENARIO'"),
        (("run", "bench.yaml", "--view"), "--view: no display for a window; must be web, for a browser"),
        (("view", "{run}"), "view: no display for a window; pass --web, for a browser"),
    ],
)
def test_what_cannot_be_done_is_refused(
    arguments: tuple[str, ...], refusal: str, recorded: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        names = {"run": recorded / "run.mcap", "port": taken.getsockname()[1]}
        done = CliRunner().invoke(cli, [each.format(**names) for each in arguments])
    said = str(done.exception) if isinstance(done.exception, InputError) else done.output
    assert refusal.format(**names) in said
