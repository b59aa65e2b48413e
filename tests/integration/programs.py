"""The command line as processes, and pseudo terminals as cables whose far end the test holds."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import threading
import tty
from collections.abc import Callable
from contextlib import suppress
from itertools import groupby
from pathlib import Path
from typing import Any

from forked import ForkedProcess
from installed_programs import LIDAR_EMU
from waiting import LIMIT_S, eventually

from lidar_protocol import Acknowledge, Host, Housekeeping, Message, SerialReceiver, default_interface

INTERFACE = default_interface()
LONG_BENCH = ["bench.yaml", "--set", "bench_pattern.duration_s=1000"]
"""A run that lasts until the test ends it, on the slowest machine too."""


class Program:
    """A `lidar-emu` process in its own session, as a shell starts it in a terminal.

    Args:
        started: start a new process instead of forking one that has loaded everything.
    """

    def __init__(self, arguments: list[str], folder: Path, name: str, started: bool = False) -> None:
        self._files = folder / f"{name}.out", folder / f"{name}.err"
        for file in self._files:
            file.touch()
        self.process: ForkedProcess | subprocess.Popen[bytes]
        if started:
            self.process = self._started(arguments, folder)
        else:
            self.process = ForkedProcess(arguments, folder, *self._files)

    def _started(self, arguments: list[str], folder: Path) -> subprocess.Popen[bytes]:
        with self._files[0].open("wb") as out, self._files[1].open("wb") as err:
            return subprocess.Popen(
                [LIDAR_EMU, *arguments],
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                start_new_session=True,
            )

    @property
    def out(self) -> str:
        """Standard output so far."""
        return self._files[0].read_text()

    @property
    def err(self) -> str:
        """Standard error so far."""
        return self._files[1].read_text()

    def word_after(self, text: str) -> str:
        """Wait until it has printed `text`, and return the next word: the path of a pty."""

        def word() -> str | None:
            _, _, rest = (self.out + self.err).partition(text)
            return rest.split()[0].rstrip(",") if "\n" in rest else None

        return str(eventually(word))

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to the program and its group, as a terminal does."""
        os.killpg(self.process.pid, number)

    def wait(self, limit_s: float = LIMIT_S) -> int:
        """Wait for its end; returns the exit code."""
        return self.process.wait(limit_s)

    def succeed(self) -> None:
        """Wait for its end, which must be a success."""
        assert self.wait() == 0, self.err
        assert self.err == ""

    def port_process(self) -> int:
        """Wait for the process that owns the port; returns its number."""

        def child() -> int | None:
            with suppress(OSError):
                pid = self.process.pid
                for text in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
                    if b"lidar_emu.runtime.port.process" in Path(f"/proc/{text}/cmdline").read_bytes():
                        return int(text)
            return None

        return int(eventually(child))

    @staticmethod
    def stall(pid: int, duration_s: float, until: Callable[[], bool] = lambda: True) -> None:
        """Stop a process of the run for at least this long, which is the stimulus, and until an event."""
        os.kill(pid, signal.SIGSTOP)
        threading.Event().wait(duration_s)
        eventually(until)
        os.kill(pid, signal.SIGCONT)

    def end(self) -> None:
        """Kill the process if it still runs."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()


def is_running(pid: int) -> bool:
    """Whether there is such a process, zombies aside."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def listened_beams(listener: Program) -> list[dict[str, Any]]:
    """The whole lines of `listen --json` so far that are beams; the others are housekeeping and acknowledgements."""
    *lines, _ = listener.out.split("\n")
    return [row for row in map(json.loads, lines) if "beam" in row]


def longest_sequence(numbers: list[int]) -> int:
    """Length of the longest sequence of consecutive numbers in an ascending list."""
    sequences = groupby(enumerate(numbers), lambda item: item[1] - item[0])
    return max((len(list(sequence)) for _, sequence in sequences), default=0)


def read_summary(path: Path) -> dict[str, Any]:
    """A summary file; NaN and Infinity, which are not JSON, are rejected."""

    def refuse(text: str) -> None:
        raise AssertionError(f"{text} is no JSON")

    reported: dict[str, Any] = json.loads(path.read_text(), parse_constant=refuse)
    return reported


class FarEnd:
    """A cable: what a program writes to the pty `path` is kept in `data`, and can be forwarded."""

    def __init__(self) -> None:
        self._data, self._reading = bytearray(), threading.Lock()
        self._forward_to: int | None = None
        # The slave stays open: without it the master would report a hang-up between two programs.
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._stop_out, self._stop = os.pipe()
        self._thread = threading.Thread(target=self._carry)
        self._thread.start()

    @property
    def data(self) -> bytearray:
        """Everything that was written so far, also by a program that has just ended."""
        # The reading thread may be behind. What it has not passed on yet is left to it.
        while self._forward_to is None and self._read():
            pass
        return self._data

    def deliver_to(self, other: FarEnd) -> None:
        """From now on pass everything on to the program that has the other cable's `path` open."""
        os.set_blocking(other.master, False)
        self._forward_to = other.master

    def send(self, data: bytes) -> None:
        """Write to the program that has `path` open."""
        _write(self.master, data)

    def wait_for(self, count: int) -> None:
        """Wait until this many bytes have arrived."""
        eventually(lambda: len(self.data) >= count)

    def _carry(self) -> None:
        while self._stop_out not in select.select([self.master, self._stop_out], [], [])[0]:
            data = self._read()
            if self._forward_to is not None:
                _write(self._forward_to, data, self._stop_out)

    def _read(self) -> bytes:
        """Read without waiting; empty if nothing has arrived."""
        with self._reading:
            # The system delivers the bytes on their way through a terminal before it states that none are there.
            is_readable = select.select([self.master], [], [], 0)[0]
            data = os.read(self.master, 65536) if is_readable else b""
            self._data += data
        return data

    def close(self) -> None:
        """Stop reading and close all descriptors."""
        os.write(self._stop, b"\0")
        self._thread.join()
        for descriptor in (self.master, self._slave, self._stop_out, self._stop):
            os.close(descriptor)


def _write(descriptor: int, data: bytes, stop: int | None = None) -> None:
    """Write everything, however full the line is, unless `stop` becomes readable: its reader may have died."""
    stops = [] if stop is None else [stop]
    while data:
        if select.select(stops, [descriptor], [])[0]:
            return
        with suppress(BlockingIOError):
            data = data[os.write(descriptor, data) :]


class PtyReader:
    """A host that opens the pty of a program and reads until the program closes it."""

    def __init__(self, path: str) -> None:
        self.data = bytearray()
        self._descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY)
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self) -> None:
        with suppress(OSError):  # EIO: the master is closed
            while data := os.read(self._descriptor, 65536):
                self.data += data

    def close(self) -> None:
        """Wait until the program closes the pty, and close this end."""
        self._thread.join()
        os.close(self._descriptor)


class CommandingHost:
    """A host at the far end, and what it has received so far."""

    def __init__(self, far_end: FarEnd) -> None:
        self._far_end = far_end
        self._sequence = 0
        self._receiver, self._decoded_bytes = SerialReceiver(INTERFACE), 0
        self._received: list[Any] = []

    @property
    def received(self) -> list[Any]:
        data = bytes(self._far_end.data[self._decoded_bytes :])
        self._received += self._receiver.receive(data)
        self._decoded_bytes += len(data)
        return self._received

    def all(self, kind: type) -> list[Any]:
        return [message for message in self.received if isinstance(message, kind)]

    def command(self, name: str, **arguments: Any) -> str:
        """Returns the verdict."""
        count = len(self.all(Acknowledge))
        self._far_end.send(Host(INTERFACE).encode_command(name, sequence=self._sequence, **arguments))
        eventually(lambda: len(self.all(Acknowledge)) > count)
        (answer,) = self.all(Acknowledge)[count:]
        assert (answer.command, answer.sequence) == (name, self._sequence)
        self._sequence += 1
        return str(answer.verdict)

    def wait_for_mode(self, mode: str) -> None:
        """Wait until the last housekeeping reports it."""
        number = INTERFACE.enumerations["mode"][mode]
        eventually(lambda: (sent := self.all(Housekeeping)) and sent[-1].values["mode"] == number)

    def wait_for_shots(self, count: int) -> None:
        before = len(self.all(Message))
        eventually(lambda: len(self.all(Message)) >= before + count)
