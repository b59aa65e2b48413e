"""However a run ends, no process and no shared memory is left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

RUN_FOR_EVER = """
import sys
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.port.sender import Pace
from lidar_emu.runtime.port.packets import OutgoingPacket
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.transports.spec import Kind, PortSpec

with PortRunner(slots=16) as runner:
    runner.start(PortSpec(Kind(sys.argv[1])))
    runner.begin(Clock().now_ns(), 10**10, Pace.WALL)
    shot = reported = 0
    try:
        while True:
            if runner.push(OutgoingPacket(shot, shot * 10**7, b"packet")):
                shot += 1
            else:
                runner.wait(Clock().now_ns() + 10**7)
            runner.far_end()
            if reported == 0 and (reported := len(runner.reports())):
                print(runner.pid, flush=True)
    except KeyboardInterrupt:
        runner.close()
        print("interrupted", runner.status.counts["sent_bytes"] is not None, flush=True)
"""

RUN_ONCE = """
import sys
from pathlib import Path
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.port.sender import Pace
from lidar_emu.runtime.port.packets import OutgoingPacket
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.transports.spec import PortSpec

with PortRunner(slots=16) as runner:
    runner.start(PortSpec())
    runner.begin(Clock().now_ns(), 0, Pace.MAX)
    runner.push(OutgoingPacket(0, 0, b"packet"))
    runner.finish()
    Path(sys.argv[1]).write_text(f"{runner.far_end().decode()} sent_bytes {runner.status.counts['sent_bytes']}")
"""

Start = Callable[[str], tuple["subprocess.Popen[str]", int]]


@pytest.fixture
def start() -> Iterator[Start]:
    """Start a run in a process group of its own, as a terminal does; gives it and its port process's id."""
    started: list[subprocess.Popen[str]] = []

    def run(kind: str) -> tuple[subprocess.Popen[str], int]:
        parent = subprocess.Popen(
            [sys.executable, "-c", RUN_FOR_EVER, kind],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            process_group=0,
        )
        started.append(parent)
        assert parent.stdout is not None
        return parent, int(parent.stdout.readline())

    yield run
    for parent in started:
        parent.kill()
        parent.communicate()


def is_alive(pid: int) -> bool:
    """Whether the process runs; one that ended and waits for its parent's notice does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.parametrize("kind", ["loopback", "pty"])
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_the_port_process_ends_with_its_parent(
    start: Start, eventually: Any, kind: str, number: signal.Signals
) -> None:
    shared_before = set(os.listdir("/dev/shm"))  # noqa: PTH208
    parent, child = start(kind)
    assert is_alive(child)
    parent.send_signal(number)
    assert parent.wait() == -number
    eventually(lambda: not is_alive(child))
    assert not {name for name in os.listdir("/dev/shm") if "lidar" in name} - shared_before  # noqa: PTH208


def test_ctrl_c_is_the_parents_business(start: Start, eventually: Any) -> None:
    parent, child = start("loopback")
    os.killpg(parent.pid, signal.SIGINT)
    output, errors = parent.communicate()
    assert (output.strip(), errors) == ("interrupted True", "")
    assert parent.returncode == 0
    eventually(lambda: not is_alive(child))


@pytest.mark.parametrize("closed", [(0,), (1,), (0, 1), (0, 1, 2)])
def test_a_run_without_standard_descriptors(closed: tuple[int, ...], tmp_path: Path) -> None:
    """Descriptors made in such a process take the numbers of the missing ones."""
    script, reported = tmp_path / "run.py", tmp_path / "reported"
    script.write_text(f"import os\nfor fd in {closed}: os.close(fd)\n{RUN_ONCE}")
    done = subprocess.run([sys.executable, script, reported], stdin=subprocess.DEVNULL, capture_output=True)
    assert (done.returncode, done.stderr) == (0, b"")
    assert reported.read_text() == "packet sent_bytes 6"


def test_a_parent_that_dies_at_once_leaves_nothing() -> None:
    """The port process finds its control pipe closed before it has received anything."""
    child = subprocess.Popen(
        [sys.executable, "-m", "lidar_emu.runtime.port.process"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    output, _ = child.communicate(b"")
    assert (child.returncode, output) == (0, b"")
    assert not is_alive(child.pid)
