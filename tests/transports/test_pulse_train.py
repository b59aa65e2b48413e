"""Pulses at shots: instants against their closed form, and lines of a driver whose answers are faked."""

from __future__ import annotations

import fcntl
import sys
import termios
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidar_emu.transports.link import Link
from lidar_emu.transports.opening import opener
from lidar_emu.transports.pulses import PulseTrain
from lidar_emu.transports.spec import Kind, PortSpec

FIRST_NS, PERIOD_NS, SHOTS = 7_003, 1_000, 60


def edges(train: PulseTrain, until_ns: int, now_ns: int = 0) -> list[tuple[int, bool]]:
    """What a process does that wakes up on time."""
    found = []
    while (wake_ns := train.wake_ns) is not None and max(wake_ns, now_ns) <= until_ns:
        now_ns = max(wake_ns, now_ns)
        if (level := train.step(now_ns)) is not None:
            found.append((now_ns, level))
    return found


FIRING = st.lists(
    st.tuples(st.integers(0, SHOTS - 1), st.integers(0, 4)), max_size=6, unique_by=lambda x: x[0]
)


@given(FIRING)
def test_a_pulse_begins_when_a_measured_shot_is_valid_and_lasts_half_a_period(
    firing: list[tuple[int, int]],
) -> None:
    firing = [*sorted(firing), (SHOTS, 0)]
    train = PulseTrain(FIRST_NS, PERIOD_NS)
    train.use(firing)
    divisors = [max((each for each in firing if each[0] <= shot), default=(0, 0))[1] for shot in range(SHOTS)]
    shots = [shot for shot, divisor in enumerate(divisors) if divisor and shot % divisor == 0]
    expected = []
    for shot in shots:
        valid_ns = FIRST_NS + shot * PERIOD_NS
        expected += [(valid_ns, True), (valid_ns + PERIOD_NS // 2, False)]
    assert edges(train, 10**9) == expected
    assert (train.count, train.latest_ns) == (len(shots), 0)


@given(st.integers(0, SHOTS * PERIOD_NS), st.integers(0, SHOTS * PERIOD_NS))
def test_after_a_stall_no_pulse_is_made_up_for(woken_ns: int, stalled_ns: int) -> None:
    train = PulseTrain(FIRST_NS, PERIOD_NS)
    train.use([(0, 1), (SHOTS, 0)])
    before = edges(train, woken_ns)
    after = edges(train, 10**9, woken_ns + stalled_ns)
    rises = [now_ns for now_ns, level in before + after if level]
    delays = [(now_ns - FIRST_NS) % PERIOD_NS for now_ns in rises]
    assert all(delay < PERIOD_NS // 2 for delay in delays)
    assert len({(now_ns - FIRST_NS) // PERIOD_NS for now_ns in rises}) == len(rises) == train.count
    assert train.latest_ns == max(delays, default=0)
    levels = [level for _, level in before + after]
    assert levels == [True, False] * len(rises)
    on_time = [shot for shot in range(SHOTS) if FIRST_NS + shot * PERIOD_NS >= woken_ns + stalled_ns]
    assert rises[len(rises) - len(on_time) :] == [FIRST_NS + shot * PERIOD_NS for shot in on_time]


def test_what_is_known_later_replaces_what_follows() -> None:
    train = PulseTrain(0, PERIOD_NS)
    train.use([(0, 1), (SHOTS, 0)])
    train.use([(3, 0), (6, 2), (9, 0)])
    assert [now_ns for now_ns, level in edges(train, 10**9) if level] == [0, 1000, 2000, 6000, 8000]


class Driver:
    """Takes the requests for lines; all others go to the pty."""

    def __init__(self, is_modem: bool) -> None:
        self.is_modem = is_modem
        self.asked: list[tuple[str, int]] = []

    def ioctl(self, descriptor: int, request: int, argument: Any = 0, *more: Any) -> Any:
        names = {termios.TIOCMBIS: "on", termios.TIOCMBIC: "off"}
        if self.is_modem and request in names:
            self.asked.append((names[request], int.from_bytes(argument, sys.byteorder)))
            return 0
        return REAL(descriptor, request, argument, *more)


REAL = fcntl.ioctl


def opened(path: str, line: str) -> Link:
    return Link(opener(PortSpec(Kind.SERIAL, path, pulse_out=line)))


@pytest.mark.parametrize(("line", "bit"), [("rts", termios.TIOCM_RTS), ("dtr", termios.TIOCM_DTR)])
def test_the_line_is_low_but_for_pulses(
    line: str, bit: int, raw_pty: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = Driver(is_modem=True)
    link = opened(raw_pty.path, "")
    monkeypatch.setattr("fcntl.ioctl", driver.ioctl)
    link.set_pulse(True)
    link.close()
    assert driver.asked == []
    link = opened(raw_pty.path, line)
    link.set_pulse(True)
    link.set_pulse(False)
    link.set_pulse(True)
    link.close()
    asked = [(what, bits) for what, bits in driver.asked if bits == bit]
    assert asked[-5:] == [(what, bit) for what in ("off", "on", "off", "on", "off")]


def test_a_port_without_the_line_is_reported_once(raw_pty: Any) -> None:
    link = opened(raw_pty.path, "dtr")
    link.set_pulse(True)
    link.service(7)
    assert link.take_events() == [(7, "no pulses on line dtr: Inappropriate ioctl for device")]
    link.close()
