"""`lidar-emu view` beside a run: a process that reads the run's recording, and cannot affect the run.

The process is `python -m lidar_emu.cli.viewer_process view FILE ...`. It begins once the run writes a line to its
standard input, and ends when the run closes it, or dies. What takes long to import is there by then.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Self

from lidar_emu.cli.terminal import print_note
from lidar_emu.errors import InputError
from lidar_emu.files import check_extra
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.signals import until_signal
from lidar_emu.viewer.addresses import (
    FOXGLOVE_PORT,
    WEB_PORT,
    check_display,
    check_free,
    web_address,
    web_socket_address,
)

_END_LIMIT_S = 5.0
_LAST_PORT = 65534
"""The next one serves the data of a page."""
_USUAL_PORTS = {"window": None, "web": WEB_PORT, "foxglove": FOXGLOVE_PORT}


class ViewerProcess(Observer):
    """Observer of a run that starts a viewer as soon as there is a recording.

    Args:
        where: window, web, foxglove, or one of the last two with :PORT.
        recording: the recording of the run; None: one that ends with the viewer.

    Raises:
        InputError: there is no such viewer, the extra that has it is not installed, or its port is in use.
    """

    def __init__(self, where: str, recording: str | None) -> None:
        kind, port = _kind_and_port(where)
        if kind == "foxglove":
            check_extra("--view", "Foxglove", "foxglove", "live")
        else:
            if kind == "window":
                check_display("--view", "must be web, for a browser")
            check_extra("--view", "the viewer", "rerun", "view")
        self._options: list[str] = []
        if port is not None:
            is_web = kind == "web"
            check_free("--view", *((port, port + 1) if is_web else (port,)))
            print_note(f"viewer: {web_address(port) if is_web else web_socket_address(port)}")
            self._options = [f"--{kind}", "--port", str(port)]
        self._folder = tempfile.TemporaryDirectory(prefix="lidar-emu-")
        self._errors = Path(self._folder.name) / "errors.txt"
        self.recording = str(Path(self._folder.name) / "run.mcap") if recording is None else recording
        self._process: subprocess.Popen[bytes]

    def __enter__(self) -> Self:
        """Start the process, which waits for `on_opened`: it costs the flight no time.

        It has a session of its own, so that Ctrl-C is for the run.
        """
        module = ["-P", "-m", "lidar_emu.cli.viewer_process"]
        command = [sys.executable, *module, "view", self.recording, *self._options]
        with self._errors.open("wb") as errors:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,
            )
        return self

    def __exit__(self, *_: object) -> None:
        with self._folder, self._process as process:
            was_open = process.poll() is None
            process.terminate()
            try:
                is_clean = process.wait(_END_LIMIT_S) >= 0
            except subprocess.TimeoutExpired:  # it is stopped, or hangs
                is_clean = False
            if not is_clean:
                with suppress(ProcessLookupError):  # what it has started may be left
                    os.killpg(process.pid, signal.SIGKILL)
            if process.wait() and not was_open:
                lines = self._errors.read_text(errors="replace").splitlines() or ["no message"]
                print_note(f"lidar-emu: warning: the viewer failed: {lines[-1]}")

    def on_opened(self, port: str, start: datetime) -> None:  # noqa: ARG002
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            self._process.stdin.write(b"\n")
            self._process.stdin.flush()

    def wait(self) -> None:
        """Wait until the viewer is closed, or until Ctrl-C."""
        if self._process.poll() is None:
            with until_signal():
                print_note("the viewer is open; Ctrl-C ends it")
                self._process.wait()


def _kind_and_port(where: str) -> tuple[str, int | None]:
    kind, colon, text = where.partition(":")
    usual = _USUAL_PORTS.get(kind)
    is_port = usual is not None and text.isascii() and text.isdigit() and len(text) <= 5
    if kind not in _USUAL_PORTS or (colon and not (is_port and 1 <= int(text) <= _LAST_PORT)):
        raise InputError("--view", None, where, "must be window, web, foxglove, web:PORT or foxglove:PORT")
    return kind, int(text) if colon else usual


def _end_with_the_run() -> None:
    sys.stdin.read()
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    from lidar_emu.cli import main
    from lidar_emu.cli.view import NICENESS
    from lidar_emu.viewer import flight_parts as follow  # noqa: F401

    os.nice(NICENESS)
    if sys.stdin.readline():
        threading.Thread(target=_end_with_the_run, daemon=True).start()
        main()
