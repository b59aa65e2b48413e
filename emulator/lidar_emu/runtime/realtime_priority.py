"""Real-time privileges of a process, and how to obtain those that the system refuses."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

_PR_SET_TIMERSLACK = 29
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_FIFO_PRIORITY = 10
_BUSY_WAIT_SHARE, _CORES_FOR_BUSY_WAIT = 0.4, 2
_ISOLATED = Path("/sys/devices/system/cpu/isolated")


@dataclass(frozen=True)
class RealtimePrivileges:
    """Result of a process's requests."""

    granted: list[str]
    """Names of the privileges that the system granted."""
    missing: dict[str, str]
    """Privileges that it refused, each with the command that grants it; see docs/timing.md."""


def request_realtime(place: int = 0) -> RealtimePrivileges:
    """Request every privilege that helps this process to wake up in time.

    Not for a process that never sleeps: it would block a core for all others.

    Args:
        place: index among the isolated cores; two processes that must not disturb each other differ in it.
    """
    gc.collect()
    gc.freeze()
    # Raising the limits of the shell that starts the emulator is enough. A capability would have to be given to the
    # Python interpreter, which in a virtual environment is a link to the whole system's.
    requests = (
        ("timer_slack", _reduce_timer_slack(), "a Linux kernel"),
        ("fifo", _enter_fifo(), f"sudo prlimit --pid $$ --rtprio={_FIFO_PRIORITY}"),
        ("locked_memory", _lock_memory(), "sudo prlimit --pid $$ --memlock=unlimited"),
        ("isolated_core", _pin(place), f"kernel command line: {_isolation(place)}"),
    )
    return RealtimePrivileges(
        [name for name, granted, _ in requests if granted],
        {name: remedy for name, granted, remedy in requests if not granted},
    )


@contextmanager
def realtime_priority() -> Iterator[None]:
    """Real-time priority in a context, where that is permitted.

    For a process that computes when something arrives. The port process, which it wakes, has the same priority, and
    therefore goes to another core instead of preempting this one.
    """
    before = (os.sched_getscheduler(0), os.sched_getparam(0)) if hasattr(os, "sched_getscheduler") else None
    _enter_fifo()
    try:
        yield
    finally:
        if before is not None:
            os.sched_setscheduler(0, *before)


def busy_wait_share() -> float:
    """Share of the time that a process may spend in busy waits: 0 on a single core, which simulator and port need.

    Two are enough, as a simulator sleeps until its next truth is due.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return _BUSY_WAIT_SHARE if cores >= _CORES_FOR_BUSY_WAIT else 0.0


def _reduce_timer_slack() -> bool:
    """Without this the kernel rounds waits up by 50 us; needs no privilege."""
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        return int(libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)) == 0
    except (OSError, AttributeError):
        return False


def _enter_fifo() -> bool:
    """SCHED_FIFO for all threads, for each may hold the interpreter's lock."""
    try:
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(_FIFO_PRIORITY))
    except (OSError, AttributeError):
        return False
    return True


def _lock_memory() -> bool:
    """Lock every page in memory, including later allocations.

    Under a finite limit the lock would make a later allocation fail in mid-run. It is requested where there is no
    limit, or by privilege: with a limit of 0 the kernel grants it to privileged processes alone.
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
    """Move to an isolated core, where nothing else runs.

    Pinning to a shared core does not help: while that core is busy in the kernel, the process cannot migrate.
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
    """Numbers of the cores that the kernel keeps free of processes that are not pinned to them."""
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
