"""`lidar-emu` that ends with the process which started it: standard input is a pipe that this process holds open."""

from __future__ import annotations

import itertools
import json
import os
import runpy
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lidar_emu.errors import RunError
from lidar_emu.recording.mcap_file import MAGIC, McapFile, ReadPosition
from lidar_emu.runtime.clock import Clock
from lidar_emu.transports.control_request import request

_TOPICS = ("/packet", "/delivery", "/truth", "/measurement")


@dataclass(frozen=True)
class Shot:
    """A shot of an emulated lidar whose delivery status is known."""

    number: int
    """Number of the shot, from 0."""
    status: str
    """Delivery status: `sent`, `late`, `dropped_full`, `dropped_nobody`, `dropped_broken`, `suppressed`, `held` or
    `not_polled`."""
    packet: bytes
    """Bytes as on the link, on CAN frame records; empty if the device sent none."""
    truth: dict[str, Any]
    """Ground truth: the fields of `/truth` in docs/recordings.md, a list entry per beam, None where there is no
    value."""
    measurement: dict[str, Any]
    """Measurement: the fields of `/measurement`, likewise."""


class GrowingRecording:
    """Reads the shots of a recording as they are written.

    Args:
        path: the recording; it need not exist yet.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._since = ReadPosition()
        self._packet = b""
        self._delivered: dict[int, tuple[str, bytes]] = {}
        self._truth: dict[str, Any] = {}

    def new_shots(self) -> list[Shot]:
        """The shots that were written since the last call."""
        shots: list[Shot] = []
        # The process creates the file, and then writes the first bytes.
        if not self._path.exists() or self._path.stat().st_size < len(MAGIC):
            return shots
        for message in McapFile(self._path).messages(*_TOPICS, since=self._since):
            match message.topic:
                case "/packet":
                    self._packet = message.data
                case "/delivery":
                    delivery = json.loads(message.data)
                    self._delivered[delivery["shot"]] = delivery["status"], self._packet
                    self._packet = b""
                case "/truth":
                    self._truth = json.loads(message.data)
                case "/measurement":
                    number = self._truth["shot"]
                    measurement = json.loads(message.data)
                    shots.append(Shot(number, *self._delivered.pop(number), self._truth, measurement))
        return shots


_READY_LIMIT_S = 300.0
"""The first run after an installation compiles for a minute, on a busy machine for several."""
_END_LIMIT_S = 10.0
_POLL_NS = 20_000_000
_READ_BYTES = 65536

_numbers = itertools.count()


class StartEmulator:
    """The function behind the fixture `lidar_emulator`; see `start_emulator`.

    Args:
        new_folder: creates the folder of a recording.
        stack: closes the emulated lidars when it is left.
    """

    def __init__(self, new_folder: Callable[[], Path], stack: ExitStack) -> None:
        self._new_folder, self._stack = new_folder, stack

    def __call__(
        self,
        scenario: str | os.PathLike[str],
        port: str | None = "pty",
        *,
        settings: Mapping[str, object] | None = None,
        arguments: Sequence[str] = (),
    ) -> LidarEmulator:
        """Start an emulated lidar."""
        started = start_emulator(self._new_folder(), scenario, port, settings=settings, arguments=arguments)
        self._stack.callback(started.close)
        return started


class LidarEmulator:
    """An emulated lidar whose port is open.

    Args:
        options: options of `lidar-emu run`, with the scenario.
        folder: folder of the recording.

    Raises:
        RunError: the process ended before its port was open; with the message of the command line.
    """

    def __init__(self, options: Sequence[str], folder: Path) -> None:
        self._clock = Clock()
        self._stack = ExitStack()
        # Socket paths are limited to 107 bytes, which a folder of pytest may exceed.
        private = self._stack.enter_context(tempfile.TemporaryDirectory(prefix="lidar-emu-"))
        self._control, self._errors = str(Path(private) / "control"), Path(private) / "errors"
        self.recording = folder / "flight.mcap"
        """The recording of the run; `lidar_emu.recording.read.read_recording` reads it, also before the end."""
        self._growing = GrowingRecording(self.recording)
        self._shots: list[Shot] = []
        self._out = b""
        kept = ["--json", "--record", str(self.recording), "--control", self._control]
        with self._errors.open("wb") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "lidar_emu.testing", "run", *options, *kept],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                start_new_session=True,  # Ctrl-C is for the tests, which then end this process
            )
        try:
            self.port = str(self._first_line()["ready"]["port"])
            """The port: the path of a pty, `udp:HOST:PORT`, or interface and channel of a CAN bus."""
        except BaseException:
            self.kill()
            raise

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def address(self) -> tuple[str, int]:
        """Host and port number to bind, on UDP."""
        host, _, number = self.port.removeprefix("udp:").rpartition(":")
        return host.strip("[]"), int(number)

    @property
    def bus(self) -> dict[str, str]:
        """Arguments of `can.Bus`, on CAN."""
        interface, _, channel = self.port.partition(" ")
        return {"interface": interface, "channel": channel}

    @property
    def shots(self) -> list[Shot]:
        """All shots so far whose delivery status is known; they follow their packets by half a second at most."""
        self._shots += self._growing.new_shots()
        return self._shots

    def wait_for_shots(self, count: int, timeout_s: float = 30.0) -> list[Shot]:
        """Wait until this many shots were sent; return all shots that were sent so far.

        Raises:
            TimeoutError: they were not sent in time.
            RunError: the run ended before.
        """
        ends_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        while True:
            has_ended = self._process.poll() is not None
            sent = [shot for shot in self.shots if shot.status == "sent"]
            if len(sent) >= count:
                return sent
            found = f"{len(sent)} of {count} shots were sent"
            if has_ended:
                raise RunError(f"{found} when the run ended: {self._error_text() or 'it was over'}")
            if self._clock.now_ns() >= ends_ns:
                raise TimeoutError(f"{found} within {timeout_s:g} s")
            self._clock.wait(self._clock.now_ns() + _POLL_NS)

    def inject(self, kind: str, **values: object) -> int:
        """Inject a fault, as `lidar-emu inject`; return its number.

        Args:
            kind: kind of fault, as in a scenario.
            values: its other keys; times count from the first shot that the fault can still affect.

        Raises:
            RunError: the run rejected it, or has ended.
        """
        if self._process.poll() is not None:
            raise RunError(f"the run has ended: {self._error_text()}")
        reply = request(self._control, json.dumps({"kind": kind, **values}))
        if not reply["accepted"]:
            raise RunError(f"rejected: {reply['reason']}")
        return int(reply["fault"])

    def finish(self, timeout_s: float = 60.0) -> dict[str, Any]:
        """Wait until the flight is over; return its summary.

        Raises:
            TimeoutError: it was not over in time.
            RunError: the run failed.
        """
        ends_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        if not self._read_out(ends_ns):
            raise TimeoutError(f"the flight was not over within {timeout_s:g} s")
        return self._summary()

    def end(self) -> dict[str, Any]:
        """End the flight as Ctrl-C does; return its summary, also after `finish`.

        Raises:
            RunError: the run failed.
        """
        self._interrupt()
        return self._summary()

    def close(self) -> None:
        """End the process, if it still runs, and release all resources."""
        self._interrupt()
        self.kill()

    def kill(self) -> None:
        """Kill the process, if it still runs, and release all resources."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            pipe.close()
        self._stack.close()

    def _interrupt(self) -> None:
        assert self._process.stdout is not None
        if self._process.stdout.closed:
            return
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
        self._read_out(self._clock.now_ns() + round(_END_LIMIT_S * 1e9))

    def _first_line(self) -> dict[str, Any]:
        ends_ns = self._clock.now_ns() + round(_READY_LIMIT_S * 1e9)
        while b"\n" not in self._out:
            if not self._read_some(ends_ns):
                raise RunError(self._error_text() or f"the port was not open within {_READY_LIMIT_S:g} s")
        line, _, self._out = self._out.partition(b"\n")
        return dict(json.loads(line))

    def _read_out(self, ends_ns: int) -> bool:
        """Read standard output to its end; False if that does not come in time."""
        while self._read_some(ends_ns):
            continue
        return self._clock.now_ns() < ends_ns

    def _read_some(self, ends_ns: int) -> bool:
        """Wait for output; False at its end, or after the time limit."""
        assert self._process.stdout is not None
        descriptor = self._process.stdout.fileno()
        ready, _ = self._clock.wait(ends_ns, [descriptor])
        data = os.read(descriptor, _READ_BYTES) if ready else b""
        self._out += data
        return bool(data)

    def _summary(self) -> dict[str, Any]:
        code = self._process.wait()
        if code != 0:
            raise RunError(self._error_text() or f"the run ended with exit code {code}")
        return dict(json.loads(self._out))

    def _error_text(self) -> str:
        return self._errors.read_text().strip() if self._errors.exists() else ""


def start_emulator(
    folder: Path,
    scenario: str | os.PathLike[str],
    port: str | None = "pty",
    *,
    settings: Mapping[str, object] | None = None,
    arguments: Sequence[str] = (),
) -> LidarEmulator:
    """Start an emulated lidar, and wait until its port is open.

    Args:
        folder: folder of the recording.
        scenario: a scenario's file or name.
        port: `pty`; `udp` for a free port of this machine; `can` for a virtual bus of its own (python-can's
            `udp_multicast`); any text that `lidar-emu run --port` takes; None: the port is among the arguments.
        settings: replaced keys of the scenario, as `--set`.
        arguments: further options of `lidar-emu run`.

    Raises:
        RunError: the run did not start; with the message of the command line.
    """
    changes = []
    for key, value in (settings or {}).items():
        changes += ["--set", f"{key}={value if isinstance(value, str) else json.dumps(value)}"]
    return LidarEmulator([os.fspath(scenario), *_port_options(port), *changes, *arguments], folder)


def _port_options(port: str | None) -> list[str]:
    if port is None:
        return []
    if port == "can":
        # An address for each bus: process and number; this block is free for use within an organisation.
        group = f"239.{os.getpid() >> 8 & 255}.{os.getpid() & 255}.{next(_numbers) % 254 + 1}"
        return ["--interface", "udp_multicast", "--channel", group]
    if port == "udp":
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            return ["--port", f"udp:{free.getsockname()[1]}"]
    return ["--port", port]


_INPUT = 0


def _end_with_input() -> None:
    while os.read(_INPUT, 1):
        continue
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    threading.Thread(target=_end_with_input, daemon=True).start()
    runpy.run_module("lidar_emu", run_name="__main__")
