"""The pytest plugin, as the tests of a flight-software repository use it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from programs import is_running
from waiting import eventually

from lidar_emu.files import cache_folder

pytest_plugins = ["pytester"]

PAGE = Path(__file__).resolve().parents[2] / "docs" / "flight-software-ci.md"
PLUGIN = ["-p", "lidar_emu.pytest_plugin", "-p", "no:cacheprovider"]
CACHE = cache_folder().parent
HEAVY = {"numpy", "numba", "scipy", "pydantic", "can", "serial", "click", "ruamel", "mcap", "rich"}


@pytest.fixture(autouse=True)
def kept_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs in pytester's home use the kernels that are compiled already."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(CACHE))


ON_EVERY_PORT = '''
import os
import socket
from concurrent.futures import ThreadPoolExecutor

import can
import pytest
from lidar_protocol import CanReceiver, Message, SerialReceiver, default_interface

FAST = {"timing.rate_hz": 100}
BAUD = ["--baud", "921600"]


def opened(path):
    return os.open(path, os.O_RDWR | os.O_NOCTTY)


def decoded(data):
    received = SerialReceiver(default_interface()).receive(data)
    return [message for message in received if isinstance(message, Message)]


def read_messages(host, count=20):
    data = b""
    while len(messages := decoded(data)) < count:
        data += os.read(host, 1 << 16)
    return messages


def agree(messages, shots):
    """A bench pattern is measured without errors."""
    truth = {shot.number: shot.truth["true_range_m"] for shot in shots}
    compared = 0
    for message in messages:
        for beam, true_range_m in zip(message.beams, truth[message.shot]):
            if beam["range_valid"]:
                assert beam["range_m"] == pytest.approx(true_range_m, abs=0.01)
                compared += 1
    assert compared > 10


def test_pty(lidar_emulator):
    lidar = lidar_emulator("bench.yaml", settings=FAST, arguments=BAUD)
    host = opened(lidar.port)
    shots = lidar.wait_for_shots(20, timeout_s=900)
    assert [shot.number for shot in shots] == list(range(len(shots)))
    data = os.read(host, 1 << 16)
    assert shots[0].packet in data
    messages = decoded(data)
    agree(messages[:20], shots)


def test_a_fault_in_flight(lidar_emulator):
    lidar = lidar_emulator("bench.yaml", settings=FAST, arguments=BAUD)
    opened(lidar.port)
    before = len(lidar.wait_for_shots(5, timeout_s=900))
    assert lidar.inject("dropout", beams=[0]) == 0
    after = lidar.wait_for_shots(before + 100)[-1]
    assert after.measurement["range_valid"][0] is False
    assert after.truth["true_range_m"][0] is not None
    with pytest.raises(Exception, match="rejected: .*nonsense"):
        lidar.inject("nonsense")
    summary = lidar.end()
    assert summary["interrupted"]
    assert summary["faults_in_flight"]["refused"] == 1
    assert lidar.end() == summary


def test_udp(lidar_emulator):
    lidar = lidar_emulator("bench.yaml", "udp", settings=FAST)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.bind(lidar.address)
        host.settimeout(900)
        received = [host.recv(4096) for _ in range(20)]
        agree(decoded(b"".join(received)), lidar.wait_for_shots(20, timeout_s=900))


def test_can(lidar_emulator):
    lidar = lidar_emulator("bench.yaml", "can", settings=FAST, arguments=["--bitrate", "1000000"])
    receiver, messages = CanReceiver(default_interface()), []
    with can.Bus(**lidar.bus) as bus:
        while len(messages) < 10:
            frame = bus.recv(900)
            messages += [
                each for each in receiver.receive(frame.arbitration_id, bytes(frame.data), frame.is_fd)
                if isinstance(each, Message)
            ]
    assert {beam["range_valid"] for message in messages for beam in message.beams} >= {True}


def test_two_at_once_and_to_the_end(lidar_emulator):
    lidars = [
        lidar_emulator("bench.yaml", settings=FAST | {"wire.unit": unit}, arguments=[*BAUD, "--duration", "0.2"])
        for unit in (1, 2)
    ]
    hosts = [opened(lidar.port) for lidar in lidars]
    # An ended run waits only a moment for the rest to be read: both hosts read at once.
    with ThreadPoolExecutor(len(hosts)) as readers:
        received = list(readers.map(read_messages, hosts))
    for unit, lidar, messages in zip((1, 2), lidars, received):
        assert {message.unit for message in messages} == {unit}
        assert lidar.finish()["shots"]["sent"] == 20
        with pytest.raises(Exception, match="20 of 21 shots were sent when the run ended"):
            lidar.wait_for_shots(21, timeout_s=900)


def test_a_host_that_does_not_read(lidar_emulator):
    lidar = lidar_emulator(
        "bench.yaml", settings={"timing.rate_hz": 1000}, arguments=["--baud", "3000000", "--duration", "1"]
    )
    opened(lidar.port)
    summary = lidar.finish()
    statuses = [shot.status for shot in lidar.shots]
    assert statuses.count("dropped_full") == summary["shots"]["dropped"]["full"] > 500
    assert statuses.count("sent") == summary["shots"]["sent"] > 10


def test_refusals(lidar_emulator):
    with pytest.raises(Exception, match="no such file"):
        lidar_emulator("nosuch.yaml")
    with pytest.raises(Exception, match="timing.rate_hz"):
        lidar_emulator("bench.yaml", settings={"timing.rate_hz": -1})
    lidar = lidar_emulator("bench.yaml", arguments=["--wait-limit", "0.5"])
    with pytest.raises(TimeoutError, match="0 of 1 shots were sent within 0.1 s"):
        lidar.wait_for_shots(1, timeout_s=0.1)
    with pytest.raises(Exception, match="waited 0.5 s for a host to open it"):
        lidar.finish()
'''

FAILING = """
from pathlib import Path


def test_fails(lidar_emulator):
    first, second = (lidar_emulator("bench.yaml") for _ in range(2))
    Path("pids").write_text(f"{first.pid} {second.pid}")
    assert first.shots == second
"""

HANGING = """
import threading
from pathlib import Path


def test_hangs(lidar_emulator):
    Path("written").write_text(str(lidar_emulator("bench.yaml").pid))
    Path("written").rename("pids")
    threading.Event().wait()
"""


def family(pids: list[int]) -> list[int]:
    """The processes and their children."""
    children = [Path(f"/proc/{pid}/task/{pid}/children") for pid in pids]
    return pids + [int(text) for file in children if file.exists() for text in file.read_text().split()]


@pytest.mark.slow
def test_the_fixture_hands_over_ports_shots_and_faults(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(ON_EVERY_PORT)
    pytester.runpytest_subprocess(*PLUGIN).assert_outcomes(passed=7)


@pytest.mark.slow
def test_the_how_to_page_passes_as_printed(pytester: pytest.Pytester) -> None:
    (program,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    pytester.makepyfile(program)
    pytester.runpytest_subprocess(*PLUGIN).assert_outcomes(passed=1)


@pytest.mark.slow
def test_a_test_that_fails_ends_its_lidars(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(FAILING)
    pytester.runpytest_subprocess(*PLUGIN).assert_outcomes(failed=1)
    pids = [int(text) for text in (pytester.path / "pids").read_text().split()]
    assert len(pids) == 2
    assert not any(map(is_running, pids))


@pytest.mark.slow
def test_tests_that_are_killed_leave_no_process(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(HANGING)
    tests = subprocess.Popen([sys.executable, "-m", "pytest", *PLUGIN], cwd=pytester.path)
    pids = family([int(eventually(lambda: _text(pytester.path / "pids")))])
    assert len(pids) == 2, "the run and its port process"
    os.kill(tests.pid, signal.SIGKILL)
    tests.wait()
    eventually(lambda: not any(map(is_running, pids)))


def _text(path: Path) -> str:
    return path.read_text() if path.exists() else ""


def test_who_does_not_use_the_fixture_loads_nothing() -> None:
    code = "import sys, lidar_emu.pytest_plugin; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    names = set(loaded.split())
    assert {name for name in names if name.startswith("lidar_emu")} == {
        "lidar_emu",
        "lidar_emu._version",
        "lidar_emu.pytest_plugin",
    }
    assert not names & HEAVY
