"""Programs that are driven line by line: what a test writes to them, and all that they have printed."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import threading
import tty
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from waiting import LIMIT_S, eventually

from lidar_protocol import Device, Host, default_interface


class LineProgram:
    """A running program; its lines of standard output are collected as they come."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self.lines: list[str] = []
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.append(line.rstrip("\n"))

    def write(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def wait_for(self, start: str, count: int = 1) -> list[list[str]]:
        """Words of the lines that begin so, once there are as many; a program that has ended has no more."""
        eventually(lambda: len(self.words(start)) >= count or not self._reader.is_alive())
        found = self.words(start)
        assert len(found) >= count, f"{len(found)} lines {start!r}, then the program ended"
        return found

    def words(self, start: str) -> list[list[str]]:
        return [line.split() for line in self.lines if line.startswith(start)]

    def end(self) -> int:
        """Wait until the program ends by itself, with all that it prints; returns its exit code."""
        code = self.process.wait(LIMIT_S)
        self._reader.join()
        return code

    def stop(self) -> None:
        self.process.terminate()
        self.process.wait()
        self._reader.join()


@contextmanager
def line_program(command: Sequence[str | Path], folder: Path) -> Iterator[LineProgram]:
    """Start a program; it is ended with the block."""
    with subprocess.Popen(
        command, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        program = LineProgram(process)
        try:
            yield program
        finally:
            program.stop()


@contextmanager
def emulator(folder: Path, *arguments: str) -> Iterator[LineProgram]:
    """An emulator that waits until its port, FOLDER/lidar, is opened."""
    command = [sys.executable, "-m", "lidar_emu", *arguments, "--json", "--port", "pty:lidar"]
    with line_program(command, folder) as lidar:
        lidar.wait_for('{"ready"')
        yield lidar


@contextmanager
def bare_port(folder: Path) -> Iterator[int]:
    """The device's end of a port, FOLDER/lidar, that has no emulator."""
    device, port = os.openpty()
    try:
        tty.setraw(port)
        (folder / "lidar").symlink_to(os.ttyname(port))
        yield device
    finally:
        os.close(device)
        os.close(port)


def received(device: int, length: int) -> bytes:
    """The next bytes that the host has sent."""
    data = b""
    while len(data) < length:
        assert select.select([device], [], [], LIMIT_S)[0], f"{len(data)} of {length} bytes"
        data += os.read(device, length - len(data))
    return data


def frame_of(name: str, sequence: int, **arguments: Any) -> bytes:
    """A command as the host sends it."""
    return Host(default_interface(), unit=0).encode_command(name, sequence=sequence, **arguments)


def answer(name: str, verdict: str, unit: int = 0) -> bytes:
    """An acknowledgement of the command with number 0."""
    return Device(default_interface(), unit).acknowledge(0, name, time_ns=0, sequence=0, verdict=verdict)
