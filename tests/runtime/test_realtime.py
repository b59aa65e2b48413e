"""What a process gets when it asks to be punctual, and that asking never harms: in processes of their own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from lidar_emu.runtime.realtime_priority import isolated_cores

WISHES = ["fifo", "isolated_core", "locked_memory", "timer_slack"]
# Before privilege is given up: who has none may not be able to read the interpreter's library.
IMPORTS = """
import ctypes, json, os, resource
from pathlib import Path
from lidar_emu.runtime.realtime_priority import request_realtime
"""
REPORT = """
before = resource.getrlimit(resource.RLIMIT_MEMLOCK)
had = request_realtime()
room = bytearray(256 << 20)
locked = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmLck"))
print(json.dumps({
    "granted": had.granted, "missing": had.missing, "room": len(room), "locked_kb": int(locked.split()[1]),
    "slack_ns": ctypes.CDLL(None).prctl(30, 0, 0, 0, 0), "scheduler": os.sched_getscheduler(0),
    "limit_kept": resource.getrlimit(resource.RLIMIT_MEMLOCK) == before,
}))
"""
NOBODY = "os.setgroups([]); os.setgid(65534); os.setuid(65534)\n"


def ask(code: str) -> dict[str, object]:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    if "not allowed to raise maximum limit" in done.stderr:
        pytest.skip("this root may not raise limits")
    assert done.returncode == 0, done.stderr
    reported: dict[str, object] = json.loads(done.stdout)
    return reported


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux reports what it granted")
def test_what_is_said_to_be_granted_is_had() -> None:
    reported = ask(IMPORTS + REPORT)
    granted, missing = reported["granted"], reported["missing"]
    assert isinstance(granted, list)
    assert isinstance(missing, dict)
    assert sorted([*granted, *missing]) == WISHES
    assert all(missing.values())
    assert reported["slack_ns"] <= 1  # a FIFO process has none, whatever it asked for
    assert (reported["scheduler"] == os.SCHED_FIFO) == ("fifo" in granted)
    assert (reported["locked_kb"] > 256 << 10) == ("locked_memory" in granted)
    assert reported["limit_kept"]
    assert reported["room"] == 256 << 20


@pytest.mark.skipif(sys.platform != "linux" or os.getuid() != 0, reason="only root can become somebody else")
@pytest.mark.parametrize("limit_bytes", [8 << 20, 1 << 30])
def test_without_privilege_under_a_finite_limit_no_memory_is_locked(limit_bytes: int) -> None:
    """A lock that the limit still allows would make the allocation after it fail."""
    limit = f"resource.setrlimit(resource.RLIMIT_MEMLOCK, ({limit_bytes}, {limit_bytes}))\n"
    no_priority = "resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))\n"
    reported = ask(IMPORTS + limit + no_priority + NOBODY + REPORT)
    assert reported["missing"] == {
        "fifo": "sudo prlimit --pid $$ --rtprio=10",
        "locked_memory": "sudo prlimit --pid $$ --memlock=unlimited",
    } | {name: how for name, how in reported["missing"].items() if name == "isolated_core"}  # type: ignore[attr-defined]
    assert reported["locked_kb"] == 0
    assert reported["room"] == 256 << 20
    assert reported["limit_kept"]


@pytest.mark.skipif(sys.platform != "linux" or os.getuid() != 0, reason="only root can raise limits")
def test_the_commands_give_what_they_promise() -> None:
    """Limits of a process are enough: no privilege, no capability."""
    raised = (
        "resource.setrlimit(resource.RLIMIT_RTPRIO, (10, 10))\n"
        "resource.setrlimit(resource.RLIMIT_MEMLOCK, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))\n"
    )
    reported = ask(IMPORTS + raised + NOBODY + REPORT)
    assert {"timer_slack", "fifo", "locked_memory"} <= set(reported["granted"])  # type: ignore[call-overload]


@pytest.mark.parametrize(
    ("text", "cores"), [("", []), ("\n", []), ("3\n", [3]), ("1,4-6,9\n", [1, 4, 5, 6, 9])]
)
def test_isolated_cores_are_read(tmp_path: Path, text: str, cores: list[int]) -> None:
    file = tmp_path / "isolated"
    file.write_text(text)
    assert isolated_cores(file) == cores


def test_a_system_that_does_not_report_has_none(tmp_path: Path) -> None:
    assert isolated_cores(tmp_path / "isolated") == []


@pytest.mark.skipif(sys.platform != "linux", reason="schedulers are the system's own")
def test_a_prompt_process_is_an_ordinary_one_again_afterwards() -> None:
    code = """
import json, os
from lidar_emu.runtime.realtime_priority import request_realtime, realtime_priority
scheduler = [os.sched_getscheduler(0)]
try:
    with realtime_priority():
        scheduler.append(os.sched_getscheduler(0))
        raise KeyError
except KeyError:
    scheduler.append(os.sched_getscheduler(0))
print(json.dumps({"scheduler": scheduler, "granted": request_realtime().granted}))
"""
    reported = ask(code)
    assert isinstance(reported["granted"], list)
    meanwhile = os.SCHED_FIFO if "fifo" in reported["granted"] else os.SCHED_OTHER
    assert reported["scheduler"] == [os.SCHED_OTHER, meanwhile, os.SCHED_OTHER]
