"""A reader's terminals: the commands of one block, typed as printed."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import IO

from installed_programs import with_programs
from waiting import LIMIT_S

# Commands that wait for a peer or keep the pace of the clock; a reader ends them with Ctrl-C.
RUNS = re.compile(r"^lidar-emu (run\b(?!.*--pace max)|replay\b.*(--port|-i ))")
LISTENS = re.compile(r"^lidar-emu listen\b")
# Programs beside a run end with it.
PEER = re.compile(r"^(python|head|candump|\./)")
WATCHED_S = 4.0
# Programs of others end as they like after Ctrl-C.
OTHERS = re.compile(r"^candump")
# A program that does not catch the signal ends by it; a shell reports 130 for both.
ENDED_WELL = {0, 130, -signal.SIGINT}


class Terminals:
    """Runs the commands of a block; leaving it presses Ctrl-C in every terminal where a command still runs.

    Args:
        folder: where they work.
        activated: folder of the programs that are found first; None: of those beside this Python.
    """

    def __init__(self, folder: Path, activated: Path | None = None) -> None:
        self.folder = folder
        self.open: list[tuple[str, subprocess.Popen[bytes], IO[bytes]]] = []
        self.environment = with_programs()
        if activated:
            self.environment["PATH"] = f"{activated}{os.pathsep}{self.environment['PATH']}"

    def __enter__(self) -> Terminals:
        return self

    def type(self, command: str) -> None:
        """Run a command. One that goes on is left running as soon as it shows its first line.

        A second run is typed in the terminal of the first, after Ctrl-C; its listeners end with it.
        """
        if RUNS.match(command) and any(RUNS.match(other) for other, _, _ in self.open):
            self.end_all()
        goes_on = RUNS.match(command) or LISTENS.match(command) or (self.open and PEER.match(command))
        if not goes_on:
            done = subprocess.run(
                ["bash", "-c", command],
                cwd=self.folder,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                timeout=LIMIT_S,
            )
            assert done.returncode == 0, (
                f"{command}: exit {done.returncode}\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
            )
            return
        screen = tempfile.TemporaryFile()  # noqa: SIM115 - open for as long as the command
        shell = subprocess.Popen(
            ["bash", "-c", f"exec {command}"],
            cwd=self.folder,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=screen,
            stderr=subprocess.STDOUT,
            process_group=0,
        )
        self.open.append((command, shell, screen))
        self._wait_until_ready(shell, screen)

    def _wait_until_ready(self, shell: subprocess.Popen[bytes], screen: IO[bytes]) -> None:
        until = time.monotonic() + LIMIT_S
        while shell.poll() is None and os.fstat(screen.fileno()).st_size == 0 and time.monotonic() < until:
            time.sleep(0.1)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self.end_all()
        finally:
            for _, shell, screen in self.open:
                shell.kill()
                shell.wait()
                screen.close()

    def end_all(self) -> None:
        """Press Ctrl-C in every terminal, the last one opened first, after some seconds of watching."""
        if self.open:
            time.sleep(WATCHED_S)
        while self.open:
            command, shell, screen = self.open[-1]
            interrupted = shell.poll() is None
            if interrupted:
                os.killpg(shell.pid, signal.SIGINT)
            code = shell.wait(30)
            self.open.pop()
            screen.seek(0)
            shown = screen.read().decode(errors="replace")[-2000:]
            screen.close()
            if interrupted and OTHERS.match(command):
                continue
            assert code in ENDED_WELL, f"{command}: exit {code}\n{shown}"
            assert "Traceback" not in shown, f"{command}\n{shown}"
