"""A device whose clock is the system clock: its reading and its lock, by a simulated kernel."""

from __future__ import annotations

import ctypes
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lidar_emu
from lidar_emu.device.commands import DeviceCommand, DeviceTimeline
from lidar_emu.device.modes import initial
from lidar_emu.device.state import DeviceConstants, device_constants
from lidar_emu.errors import InputError
from lidar_emu.runtime.change_queue import ChangeQueue, SystemClockFollower
from lidar_emu.runtime.clock import Clock, Discipline, SystemTime
from lidar_emu.runtime.options import RunOptions
from lidar_emu.runtime.port.packets import Pace
from lidar_emu.runtime.run import Run
from lidar_emu.scenario.device import DeviceBehaviour
from lidar_emu.shots.model import build_model
from lidar_emu.transports.spec import PortSpec

S, MS = 10**9, 10**6
EPOCH_UTC_NS, AHEAD_NS, START_NS = 1_700_000_000 * S, 1_790_000_000 * S, 70 * S


def kernel_us(now_ns: int, updated_ns: int, stated_us: int) -> int:
    """Maximum error as second_overflow() of Linux counts it: 500 us with each full second since the last update."""
    return stated_us + 500 * (now_ns // S - updated_ns // S)


@settings(max_examples=30)
@given(
    st.integers(0, S - 1), st.sampled_from([1, 2, 16]), st.integers(0, 20_000), st.integers(0, 99), st.booleans()
)  # fmt: skip
def test_a_dead_master_shows_in_the_growth_of_the_error(
    phase_ns: int, interval_s: int, stated_us: int, poll_ms: int, ends: bool
) -> None:
    """One that lives never does, though its updates may be hidden between two steps of the growth."""
    holdover_ns = (interval_s + 3) * S
    discipline = Discipline(holdover_ns)
    interval_ns, lost_ns = interval_s * S, None
    last_ns = phase_ns + (4 if ends else 40) * interval_ns
    for now_ns in range(phase_ns + poll_ms * MS, last_ns + 2 * holdover_ns, 100 * MS):
        updated_ns = min(last_ns, now_ns - (now_ns - phase_ns) % interval_ns)
        error_us = kernel_us(now_ns, updated_ns, stated_us)
        discipline.update(now_ns, SystemTime(0, 0, True, error_us))
        if discipline.since_ns is None:
            lost_ns = now_ns
            break
    assert lost_ns is not None
    assert last_ns + holdover_ns - 2.5 * S <= lost_ns <= last_ns + holdover_ns + 1.2 * S


def test_the_kernels_flag_counts_without_a_holdover() -> None:
    discipline = Discipline(None)
    since = []
    for second, synchronised in enumerate([False, True, True, False, True]):
        discipline.update(second * S, SystemTime(0, 0, synchronised, 16_000_000))
        since.append(discipline.since_ns)
    assert since == [None, S, S, None, 4 * S]


class Timex(ctypes.Structure):
    """adjtimex(2)."""

    _fields_ = (
        ("modes", ctypes.c_uint), ("offset", ctypes.c_long), ("freq", ctypes.c_long), ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long), ("status", ctypes.c_int), ("constant", ctypes.c_long),
        ("precision", ctypes.c_long), ("tolerance", ctypes.c_long), ("seconds", ctypes.c_long),
        ("microseconds", ctypes.c_long), ("tick", ctypes.c_long), ("ppsfreq", ctypes.c_long),
        ("jitter", ctypes.c_long), ("shift", ctypes.c_int), ("stabil", ctypes.c_long), ("jitcnt", ctypes.c_long),
        ("calcnt", ctypes.c_long), ("errcnt", ctypes.c_long), ("stbcnt", ctypes.c_long), ("tai", ctypes.c_int),
        ("padding", ctypes.c_int * 11),
    )  # fmt: skip


@pytest.mark.parametrize(("status", "synchronised"), [(0x2000, True), (0x2040, False)])
def test_the_kernel_is_asked_and_never_told(
    monkeypatch: pytest.MonkeyPatch, status: int, synchronised: bool
) -> None:
    class Libc:
        @staticmethod
        def adjtimex(buffer: Any) -> int:
            timex = Timex.from_buffer(buffer)
            assert timex.modes == 0, "nothing may be set"
            timex.maxerror, timex.esterror, timex.status = 1234, 5678, status
            return 0

    monkeypatch.setattr(ctypes, "CDLL", lambda _name: Libc)
    found = Clock().system_time()
    assert (found.max_error_us, found.synchronised) == (1234, synchronised)


class Host:
    """Port and clock of a run, as the test sets them; it has no commands."""

    def __init__(self, **clock: Any) -> None:
        self.time_ns, self.ahead_ns, self.synchronised = 0, AHEAD_NS, False
        part = DeviceBehaviour.model_validate({"clock": {"source": "system", **clock}})
        self.constants: DeviceConstants = device_constants(part, 20.0, 4, 2)
        self.device = DeviceTimeline(self.constants, initial(self.constants))
        follower = SystemClockFollower(self.device, EPOCH_UTC_NS, self)  # type: ignore[arg-type]
        self.queue = ChangeQueue(None, None, None, follower)  # type: ignore[arg-type]

    def now_ns(self) -> int:
        return START_NS + self.time_ns

    def system_time(self) -> SystemTime:
        return SystemTime(self.ahead_ns, 300, self.synchronised, 0)

    def at(self, time_s: float) -> tuple[int, bool]:
        """Error of the reading at a scenario time, and whether the clock is locked."""
        self.time_ns = round(time_s * 1e9)
        self.queue.receive(self.time_ns, START_NS)
        state = self.device.at(self.time_ns)
        utc_ns = START_NS + self.time_ns + self.ahead_ns
        return state.clock.reads_ns(self.time_ns) - (utc_ns - EPOCH_UTC_NS), state.clock_locked


def test_the_clock_reads_utc_since_the_epoch_and_follows_its_steps() -> None:
    host = Host()
    assert host.at(-0.1) == (0, False)
    first = host.queue.first
    assert first is not None
    host.synchronised = True
    assert host.at(5) == (0, True)
    host.ahead_ns -= 3600 * S
    assert host.at(5.05) == (3600 * S, True), "polled ten times a second"
    assert host.at(5.1) == (0, True)
    host.ahead_ns += 500  # what the reading itself is off
    assert host.at(6) == (-500, True)
    host.synchronised = False
    assert host.at(7) == (-500, False)


def test_it_locks_so_long_after_it_is_kept_and_after_a_cold_restart() -> None:
    host = Host(lock_s=2.0)
    host.synchronised = True
    assert [host.at(time_s)[1] for time_s in (1, 2.9, 3.0, 4)] == [False, False, True, True]
    reset = DeviceCommand("reset", {"restart": "cold"}, 5 * S, 5 * S)
    assert host.device.execute(reset)[1] == "accepted"
    assert [host.at(time_s) for time_s in (5.1, 6.9, 7.0)] == [(0, False), (0, False), (0, True)]


def test_the_tone_does_not_set_it() -> None:
    host = Host()
    tone = DeviceCommand("time_at_tone", {"tone_ns": 7}, S, S)
    assert host.device.execute(tone) == (None, "out_of_state")


@pytest.mark.parametrize(
    ("keys", "match"),
    [
        ({"pace": "max"}, "needs --pace wall, on Linux"),
        ({"timing.epoch": "2200-01-01T00:00:00Z"}, "instant in the past"),
        ({"device.clock.drift_ppm": "1"}, "left out beside source: system"),
        ({"device.clock.holdover_s": "1"}, "at least 4 beside source: system"),
    ],
)
def test_what_cannot_be_is_refused(keys: dict[str, str], match: str) -> None:
    pace = Pace(keys.pop("pace", "wall"))
    base = {"timing.epoch": "2020-01-01T00:00:00Z", "device.clock.source": "system"}

    def fly() -> None:
        scenario = lidar_emu.load("bench.yaml", base | keys)
        Run(scenario, build_model(scenario), RunOptions(PortSpec(), pace), []).fly()  # type: ignore[arg-type]

    with pytest.raises(InputError, match=match):
        fly()
