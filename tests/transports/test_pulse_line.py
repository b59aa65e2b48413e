"""Pulses on a modem line. A pty has no such lines: the driver's answers are faked, the rest is real."""

from __future__ import annotations

import fcntl
import os
import termios
import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any

import pytest
from waiting import LIMIT_S

from lidar_emu.transports.link import Link
from lidar_emu.transports.opening import opener
from lidar_emu.transports.spec import Kind, PortSpec

ioctl = fcntl.ioctl
LINES = {"cd": termios.TIOCM_CD, "cts": termios.TIOCM_CTS, "dsr": termios.TIOCM_DSR}


class Modem:
    """A driver whose lines the test sets. Its clock advances only as the test sets it."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.state = 0
        self.waits_for: list[int] = []
        self._edges: SimpleQueue[None] = SimpleQueue()
        self._waiting = threading.Semaphore(0)

    def ioctl(self, descriptor: int, request: int, argument: Any = 0, *more: Any) -> Any:
        if request == termios.TIOCMIWAIT:
            self.waits_for.append(argument)
            self._waiting.release()
            self._edges.get()
            return 0
        if request == termios.TIOCMGET:
            argument[:] = self.state.to_bytes(4, "little")
            return 0
        return ioctl(descriptor, request, argument, *more)

    def change(self, now_ns: int, state: int) -> None:
        """The line changes; returns once the watcher waits for the next edge."""
        assert self._waiting.acquire(timeout=LIMIT_S)
        self.now_ns, self.state = now_ns, state
        self._edges.put(None)
        assert self._waiting.acquire(timeout=LIMIT_S)
        self._waiting.release()


@pytest.fixture
def modem(monkeypatch: pytest.MonkeyPatch) -> Modem:
    modem = Modem()
    monkeypatch.setattr("fcntl.ioctl", modem.ioctl)
    return modem


def opened(path: str, line: str, now_ns: Callable[[], int]) -> Link:
    return Link(opener(PortSpec(Kind.SERIAL, path, pulse_line=line), now_ns=now_ns))


@pytest.mark.parametrize("line", LINES)
def test_a_pulse_begins_with_a_rising_edge(line: str, raw_pty: Any, modem: Modem) -> None:
    link = opened(raw_pty.path, line, lambda: modem.now_ns)
    bit = LINES[line]
    reported = []
    for now_ns, state in ((1000, bit), (1100, 0), (2000, bit), (2100, 0), (3000, bit)):
        modem.change(now_ns, state)
        link.service(0)
        reported.append(link.pulse_ns)
    assert reported == [1000, 1000, 2000, 2000, 3000]
    assert set(modem.waits_for) == {bit}
    link.close()


def test_the_last_pulse_is_known_with_what_arrives(raw_pty: Any, modem: Modem) -> None:
    link = opened(raw_pty.path, "cd", lambda: modem.now_ns)
    assert link.pulse_ns is None
    modem.change(5_000, LINES["cd"])
    os.write(raw_pty.master, b"at the tone")
    data = b""
    while not data:
        data = link.receive(6_000)
    assert (data, link.pulse_ns) == (b"at the tone", 5_000)
    link.close()


def test_who_closes_the_port_leaves_it_to_others_though_no_edge_comes(raw_pty: Any, modem: Modem) -> None:
    opened(raw_pty.path, "cd", lambda: modem.now_ns).close()
    again = opened(raw_pty.path, "cd", lambda: modem.now_ns)
    again.close()


def test_a_line_that_cannot_be_watched_is_reported_once(raw_pty: Any) -> None:
    link = opened(raw_pty.path, "dsr", lambda: 0)
    reported: list[str] = []
    for _ in range(10_000_000):
        link.service(7)
        reported += [text for _, text in link.take_events()]
        if reported:
            break
    link.service(8)
    assert reported + [text for _, text in link.take_events()] == [
        "no pulses from line dsr: Inappropriate ioctl for device"
    ]
    assert link.pulse_ns is None
    link.close()


def test_without_a_name_no_line_is_watched(raw_pty: Any, modem: Modem) -> None:
    link = opened(raw_pty.path, "", lambda: modem.now_ns)
    link.service(0)
    assert modem.waits_for == []
    link.close()
