"""What the system grants a process that wants to wake up in time, and how to have what it refused."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

_PR_SET_TIMERSLACK = 29
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_FIFO_PRIORITY = 10
_AWAKE_SHARE, _CORES_TO_STAY_AWAKE = 0.2, 3
_ISOLATED = Path("/sys/devices/system/cpu/isolated")


@dataclass(frozen=True)
class RealtimePrivileges:
    """What was asked for."""

    granted: list[str]
    """Names of what the system gave."""
    missing: dict[str, str]
    """What it refused, each with the command that would give it; docs/bench-machine.md has more."""


class _Wish(NamedTuple):
    name: str
    ask: Callable[[], bool]
    remedy: str


def request_realtime(place: int = 0) -> RealtimePrivileges:
    """Ask for everything that helps this process to wake up in time.

    Not for a process that never sleeps: it would keep a core from everybody else.

    Args:
        place: of the isolated cores, which one; two processes that must not disturb each other differ in it.
    """
    gc.collect()
    gc.freeze()
    # Limits of the shell that starts the emulator are enough. A capability would have to be given to the Python
    # interpreter, which in a virtual environment is a link to the whole system's.
    wishes = (
        _Wish("timer_slack", _reduce_timer_slack, "a Linux kernel"),
        _Wish("fifo", _enter_fifo, f"sudo prlimit --pid $$ --rtprio={_FIFO_PRIORITY}"),
        _Wish("locked_memory", _lock_memory, "sudo prlimit --pid $$ --memlock=unlimited"),
        _Wish("isolated_core", lambda: _pin(place), f"kernel command line: {_isolation(place)}"),
    )
    asked = [(wish, wish.ask()) for wish in wishes]
    return RealtimePrivileges(
        [wish.name for wish, given in asked if given],
        {wish.name: wish.remedy for wish, given in asked if not given},
    )


@contextmanager
def prompt() -> Iterator[None]:
    """Before all ordinary processes for a while, where that is permitted.

    For a process that computes when something arrives. The port's process, which it wakes, has the same priority, and
    so goes to another core instead of taking this one.
    """
    before = (os.sched_getscheduler(0), os.sched_getparam(0)) if hasattr(os, "sched_getscheduler") else None
    _enter_fifo()
    try:
        yield
    finally:
        if before is not None:
            os.sched_setscheduler(0, *before)


def busy_wait_share() -> float:
    """Of the time, how much a process may stay awake for what it expects: none where a simulator, the model and the
    port have less than a core each."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return _AWAKE_SHARE if cores >= _CORES_TO_STAY_AWAKE else 0.0


def _reduce_timer_slack() -> bool:
    """The kernel rounds waits up by 50 us unless told otherwise; needs no privilege."""
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        return int(libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)) == 0
    except (OSError, AttributeError):
        return False


def _enter_fifo() -> bool:
    """Before all ordinary processes, where that is permitted; all threads, for each may hold the interpreter's lock."""
    try:
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(_FIFO_PRIORITY))
    except (OSError, AttributeError):
        return False
    return True


def _lock_memory() -> bool:
    """Keep every page in memory, those of later allocations too.

    Under a finite limit that lock would make a later allocation fail in mid-run. So it is asked for where there is no
    limit, or by privilege: with a limit of 0 the kernel grants it to the privileged alone.
    """
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    unlimited = limit[0] == resource.RLIM_INFINITY
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        if not unlimited:
            resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, limit[1]))
        return int(libc.mlockall(_MCL_CURRENT | _MCL_FUTURE)) == 0
    except (OSError, ValueError, AttributeError):
        return False
    finally:
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_MEMLOCK, limit)


def _pin(place: int) -> bool:
    """Move to an isolated core, where nobody else runs.

    Among others' processes a pinned one is not earlier: where its core is busy in the kernel, it cannot go elsewhere.
    """
    cores = isolated_cores()
    try:
        if place < len(cores):
            os.sched_setaffinity(0, {cores[place]})
            return True
    except (OSError, AttributeError):
        pass  # the core is outside of this process' cpuset
    return False


def isolated_cores(file: Path = _ISOLATED) -> list[int]:
    """Numbers of the cores that the kernel keeps free of processes that do not ask for them."""
    try:
        text = file.read_text().strip()
    except OSError:
        return []
    ranges = [part.split("-") for part in text.split(",") if part]
    return [core for ends in ranges for core in range(int(ends[0]), int(ends[-1]) + 1)]


def _isolation(place: int) -> str:
    count = os.cpu_count() or 1
    cores = ",".join(str(core) for core in range(max(1, count - 1 - place), count))
    return f"isolcpus=managed_irq,domain,{cores} nohz_full={cores}" if cores else "none: there is one core"
